/** Control for a number with a unit that the user selects from a list of values. */

import { Button, Label, ListBox, ListBoxItem, Popover, Select, SelectValue } from "react-aria-components";
import { fixed } from "../state/format";
import { Tip, useKeysBack } from "./controls";
import { Icon } from "./icons";

interface FigureProps {
  /** Label of the control, visible or for screen readers only. */
  label: string;
  quiet?: boolean;
  /** Tooltip of the control. */
  words?: string;
  unit: string;
  /** Selected value; null is shown as the text `none`. */
  value: number | null;
  choices: readonly number[];
  /** Text of the choice "no value" (null); without this text the list has no such choice. */
  none?: string;
  testId?: string;
  onChange: (value: number | null) => void;
}

const NONE = "none";

/** Render the selected number as a button that opens the list of values. */
export function Figure({ label, quiet = false, words, unit, value, choices, none, testId, onChange }: FigureProps) {
  const known = value === null || choices.includes(value) ? choices : [...choices, value].sort((a, b) => a - b);
  const text = (choice: number | null): string =>
    choice === null ? (none ?? "") : `${fixed(choice, Number.isInteger(choice) ? 0 : 1)}\u202f${unit}`;
  const all: readonly (number | null)[] = none === undefined ? known : [null, ...known];
  const keyOf = (choice: number | null): string => (choice === null ? NONE : String(choice));
  const keysBack = useKeysBack();
  const button = (
    <Button className="button" data-testid={testId} onPressStart={keysBack.onPressStart}>
      <SelectValue>{() => text(value)}</SelectValue>
      <Icon name="down" />
    </Button>
  );
  return (
    <Select
      onOpenChange={keysBack.onOpenChange}
      className="select"
      aria-label={quiet ? label : undefined}
      selectedKey={keyOf(value)}
      onSelectionChange={(key) => {
        if (key === null || key === keyOf(value)) return;
        onChange(key === NONE ? null : Number(key));
      }}
    >
      {quiet ? null : <Label>{label}</Label>}
      {words === undefined ? button : <Tip words={words}>{button}</Tip>}
      <Popover className="popover" offset={4}>
        <ListBox className="listbox">
          {all.map((choice) => (
            <ListBoxItem key={keyOf(choice)} id={keyOf(choice)} textValue={text(choice)} className="listbox-item">
              {text(choice)}
            </ListBoxItem>
          ))}
        </ListBox>
      </Popover>
    </Select>
  );
}
