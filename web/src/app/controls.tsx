/** Basic controls of all panels: tooltip, button, toggle button, and choice. */

import { type ReactElement, type ReactNode, useRef } from "react";
import { Button, ToggleButton, ToggleButtonGroup, Tooltip, TooltipTrigger } from "react-aria-components";
import type { IconName } from "./icons";
import { Icon } from "./icons";

/** Time, ms, that the cursor rests on a control before its tooltip appears. */
const TOOLTIP_DELAY_MS = 450;

/** Render a tooltip on a control, with the key that has the same effect as the control. */
export function Tip({ words, keys, children }: { words: string; keys?: string; children: ReactElement }) {
  return (
    <TooltipTrigger delay={TOOLTIP_DELAY_MS} closeDelay={80}>
      {children}
      <Tooltip className="tooltip" offset={6}>
        {words}
        {keys === undefined || keys === "" ? null : <kbd>{keys}</kbd>}
      </Tooltip>
    </TooltipTrigger>
  );
}

/**
 * Remove the focus from a button after a click by mouse, so that the keys move the tip; a button reached by Tab keeps
 * the focus.
 */
export function giveKeysBack(pointerType: string): void {
  if (pointerType === "keyboard" || pointerType === "virtual") return;
  if (document.activeElement instanceof HTMLElement) document.activeElement.blur();
}

/** Time, ms, to wait after a list was closed, until it has returned the focus to its button. */
const LIST_CLOSED_MS = 100;

/**
 * Return the handlers of the button and of the list of a selection that remove the focus from the button after a choice
 * by mouse; otherwise the keys of the flight would change the selection or open the list again. Another element that
 * has the focus by then keeps it.
 */
export function useKeysBack() {
  const button = useRef<Element | null>(null);
  return {
    onPressStart: (event: { pointerType: string; target: Element }) => {
      const byPointer = event.pointerType !== "keyboard" && event.pointerType !== "virtual";
      button.current = byPointer ? event.target : null;
    },
    onOpenChange: (open: boolean) => {
      const pressed = button.current;
      if (open || pressed === null) return;
      button.current = null;
      setTimeout(() => {
        const focused = document.activeElement;
        if (focused instanceof HTMLElement && pressed.contains(focused)) focused.blur();
      }, LIST_CLOSED_MS);
    },
  };
}

/**
 * Return the accessible name of a button: its description, after the word beside its icon if the description does not
 * contain that word. Speech control presses a button by the text that is visible on it.
 */
export function buttonName(words: string, short: string | undefined): string {
  if (short === undefined || new RegExp(`\\b${short}\\b`, "i").test(words)) return words;
  return `${short}: ${words}`;
}

interface ActProps {
  words: string;
  keys?: string;
  icon?: IconName;
  label?: ReactNode;
  /** Word beside the icon of a button without another label; hidden where there is no space for it. */
  short?: string;
  kind?: "plain" | "primary" | "quiet" | "icon";
  disabled?: boolean;
  testId?: string;
  onPress: () => void;
}

/** Render a button with a tooltip. */
export function Act({ words, keys, icon, label, short, kind = "plain", disabled = false, testId, onPress }: ActProps) {
  const name = typeof label === "string" ? {} : { "aria-label": buttonName(words, short) };
  return (
    <Tip words={words} keys={keys}>
      <Button
        {...name}
        className={`button ${kind}`}
        isDisabled={disabled}
        data-testid={testId}
        onPress={(event) => {
          giveKeysBack(event.pointerType);
          onPress();
        }}
      >
        {icon === undefined ? null : <Icon name={icon} />}
        {label}
        <IconLabel text={short} />
      </Button>
    </Tip>
  );
}

interface SwitchProps {
  words: string;
  /** Name for screen readers, if the label states only the state of the switch. */
  name?: string;
  keys?: string;
  icon?: IconName;
  label?: string;
  /** Word beside the icon of a switch without another label; hidden where there is no space for it. */
  short?: string;
  on: boolean;
  disabled?: boolean;
  testId?: string;
  onChange: () => void;
}

/** Render a toggle button with a tooltip. */
export function SwitchKey({
  words,
  name,
  keys,
  icon,
  label,
  short,
  on,
  disabled = false,
  testId,
  onChange,
}: SwitchProps) {
  return (
    <Tip words={words} keys={keys}>
      <ToggleButton
        className={label === undefined ? "button icon toggle" : "button toggle"}
        aria-label={name ?? (label === undefined ? buttonName(words, short) : undefined)}
        isSelected={on}
        isDisabled={disabled}
        data-testid={testId}
        onPress={(event) => giveKeysBack(event.pointerType)}
        onChange={onChange}
      >
        {icon === undefined ? null : <Icon name={icon} />}
        {label}
        <IconLabel text={short} />
      </ToggleButton>
    </Tip>
  );
}

/** Render the word beside an icon; the style sheets hide the word where there is no space for it. */
export function IconLabel({ text }: { text: string | undefined }) {
  return text === undefined ? null : <span className="icon-label">{text}</span>;
}

interface ChoiceProps<T extends string> {
  name: string;
  value: T;
  choices: readonly { value: T; label: string; words: string; keys?: string; disabled?: boolean }[];
  onChange: (value: T) => void;
}

/** Render a row of buttons of which exactly one is selected. */
export function Choice<T extends string>({ name, value, choices, onChange }: ChoiceProps<T>) {
  return (
    <ToggleButtonGroup
      aria-label={name}
      className="choice"
      selectionMode="single"
      disallowEmptySelection
      selectedKeys={[value]}
      onSelectionChange={(keys) => {
        const chosen = choices.find((choice) => keys.has(choice.value));
        if (chosen !== undefined && chosen.value !== value) onChange(chosen.value);
      }}
    >
      {choices.map((choice) => (
        <Tip key={choice.value} words={choice.words} keys={choice.keys}>
          <ToggleButton
            id={choice.value}
            className="button toggle"
            isDisabled={choice.disabled ?? false}
            onPress={(event) => giveKeysBack(event.pointerType)}
          >
            {choice.label}
          </ToggleButton>
        </Tip>
      ))}
    </ToggleButtonGroup>
  );
}
