/** Listens to the keyboard on the whole page, in front of the panels, and leaves alone every key that is not Carina's. */

import { type Action, bindingOf, type FocusKind, type HoldAxis, takesKey } from "./keymap";

export interface KeyboardHandlers {
  press(action: Action): void;
  hold(axis: HoldAxis, sign: 1 | -1, down: boolean): void;
  slow(on: boolean): void;
  /** Whether an action means something now; else its key belongs to whoever else wants it. */
  wants(action: Action): boolean;
  /** A tool is in the hand. */
  holdsTool(): boolean;
  /** Left and right look while there is no path to choose ways on. */
  arrowsLook(): boolean;
  enabled(): boolean;
}

const TYPING_INPUTS = new Set(["text", "search", "number", "email", "url", "password", "tel", "date"]);
const ARROW_ROLES =
  "[aria-haspopup],[role=tree],[role=treegrid],[role=grid],[role=listbox],[role=menu],[role=slider],[role=radiogroup],[role=tablist],[role=toolbar]";

export function focusKind(target: EventTarget | null): FocusKind {
  if (!(target instanceof HTMLElement)) return "page";
  if (target.isContentEditable || target instanceof HTMLTextAreaElement || target instanceof HTMLSelectElement) {
    return "typing";
  }
  if (target instanceof HTMLInputElement) return TYPING_INPUTS.has(target.type) ? "typing" : "arrows";
  if (target.closest("[role=dialog],[role=alertdialog]") !== null) return "typing";
  if (target.closest(ARROW_ROLES) !== null) return "arrows";
  return target.closest("button,a,summary") === null ? "page" : "button";
}

/** What lies over the page is closed first. */
const OVER_THE_PAGE = "[role=dialog],[role=alertdialog],[role=listbox],[role=menu]";

function closesFirst(target: EventTarget | null): boolean {
  return target instanceof HTMLElement && target.closest(OVER_THE_PAGE) !== null;
}

/** Returns how to stop listening. */
export function listenToKeys(page: Window, handlers: KeyboardHandlers): () => void {
  /** Held keys by physical key: the letter may change while Shift comes and goes. */
  const held = new Map<string, { axis: HoldAxis; sign: 1 | -1 }>();

  const begin = (code: string, axis: HoldAxis, sign: 1 | -1) => {
    if (held.has(code)) return;
    held.set(code, { axis, sign });
    handlers.hold(axis, sign, true);
  };
  const end = (code: string) => {
    const was = held.get(code);
    if (was === undefined) return;
    held.delete(code);
    handlers.hold(was.axis, was.sign, false);
  };
  const down = (event: KeyboardEvent) => {
    handlers.slow(event.shiftKey);
    if (event.defaultPrevented || event.isComposing || !handlers.enabled()) return;
    const binding = bindingOf(event);
    if (binding === null) return;
    const focus = focusKind(event.target);
    // Esc puts a tool down first, wherever the focus is: a field keeps its text, and the full view stays.
    const putsDown = event.key === "Escape" && handlers.holdsTool() && !closesFirst(event.target);
    if (!takesKey(focus, event) && !putsDown) return;
    if (binding.command.kind === "press" && !handlers.wants(binding.command.action)) return;
    event.preventDefault();
    event.stopPropagation();
    const { command } = binding;
    if (command.kind === "hold") {
      begin(event.code, command.axis, command.sign);
    } else if (command.kind !== "press") {
      return;
    } else if ((command.action === "way_left" || command.action === "way_right") && handlers.arrowsLook()) {
      begin(event.code, "yaw", command.action === "way_left" ? -1 : 1);
    } else if (!event.repeat) {
      handlers.press(command.action);
    }
  };
  const up = (event: KeyboardEvent) => {
    handlers.slow(event.shiftKey);
    end(event.code);
  };
  // A window that loses the focus never hears the key go up: without this the scope would fly on by itself.
  const release = () => {
    for (const code of [...held.keys()]) end(code);
  };
  page.addEventListener("keydown", down, { capture: true });
  page.addEventListener("keyup", up, { capture: true });
  page.addEventListener("blur", release);
  return () => {
    release();
    page.removeEventListener("keydown", down, { capture: true });
    page.removeEventListener("keyup", up, { capture: true });
    page.removeEventListener("blur", release);
  };
}
