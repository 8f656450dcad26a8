/** A number selected from a list of values, with its unit. */

import { useRef } from "react";
import { Button, Label, ListBox, ListBoxItem, Popover, Select, SelectValue } from "react-aria-components";
import { fixed } from "../state/format";
import { Tip } from "./controls";
import { Icon } from "./icons";

interface FigureProps {
  /** The label, visible or for screen readers only. */
  label: string;
  quiet?: boolean;
  /** The tooltip. */
  words?: string;
  unit: string;
  /** The value; null is shown as `none`. */
  value: number | null;
  choices: readonly number[];
  /** The text for null; without it the value is always a number. */
  none?: string;
  testId?: string;
  onChange: (value: number | null) => void;
}

const NONE = "none";

/** Time, ms, after which the closed list has returned the focus to its button. */
const GONE_MS = 100;

/** Render a number with its list of values. */
export function Figure({ label, quiet = false, words, unit, value, choices, none, testId, onChange }: FigureProps) {
  const known = value === null || choices.includes(value) ? choices : [...choices, value].sort((a, b) => a - b);
  const text = (choice: number | null): string =>
    choice === null ? (none ?? "") : `${fixed(choice, Number.isInteger(choice) ? 0 : 1)}\u202f${unit}`;
  const all: readonly (number | null)[] = none === undefined ? known : [null, ...known];
  const keyOf = (choice: number | null): string => (choice === null ? NONE : String(choice));
  const byPointer = useRef(false);
  /** Return the focus to the flight after a choice by mouse; otherwise the space bar would open the list again. */
  const giveKeysBack = (open: boolean) => {
    if (open || !byPointer.current) return;
    byPointer.current = false;
    setTimeout(() => {
      if (document.activeElement instanceof HTMLElement) document.activeElement.blur();
    }, GONE_MS);
  };
  const button = (
    <Button
      className="button"
      data-testid={testId}
      onPressStart={(event) => {
        byPointer.current = event.pointerType !== "keyboard" && event.pointerType !== "virtual";
      }}
    >
      <SelectValue>{() => text(value)}</SelectValue>
      <Icon name="down" />
    </Button>
  );
  return (
    <Select
      onOpenChange={giveKeysBack}
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
