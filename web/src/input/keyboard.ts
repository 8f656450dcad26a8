/**
 * Keyboard listener of the whole page. It runs before the listeners of the panels, and ignores keys without a binding.
 */

import { type Action, bindingOf, type FocusKind, type HoldAxis, takesKey } from "./keymap";

/** Callbacks of the keyboard listener. */
export interface KeyboardHandlers {
  press(action: Action): void;
  hold(axis: HoldAxis, sign: 1 | -1, down: boolean): void;
  slow(on: boolean): void;
  /** Return whether an action is possible now. If it is not, the browser receives its key. */
  isAvailable(action: Action): boolean;
  /** Return whether an attempt at a task is running; an attempt has separate keys. */
  inTask(): boolean;
  /** Return whether a tool is active, which Escape then deactivates. */
  holdsTool(): boolean;
  /**
   * Return whether the left and right arrows turn the view, because the tip is not on a route whose branches they could
   * select.
   */
  arrowsLook(): boolean;
  enabled(): boolean;
}

const TYPING_INPUTS = new Set(["text", "search", "number", "email", "url", "password", "tel", "date"]);
const ARROW_ROLES =
  "[aria-haspopup],[role=tree],[role=treegrid],[role=grid],[role=listbox],[role=menu],[role=slider],[role=radiogroup],[role=tablist],[role=toolbar]";

/** Return which keys the focused element uses itself. */
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

/** Selector of elements over the page (dialogs, lists, menus), which Escape closes first. */
const OVER_THE_PAGE = "[role=dialog],[role=alertdialog],[role=listbox],[role=menu]";

function closesFirst(target: EventTarget | null): boolean {
  return target instanceof HTMLElement && target.closest(OVER_THE_PAGE) !== null;
}

/** Return whether the browser shows the list of a selection; true in a browser that does not report it. */
function isOpen(select: HTMLSelectElement): boolean {
  try {
    return select.matches(":open");
  } catch {
    return true;
  }
}

const ARROWS: readonly string[] = ["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown"];

/**
 * Return whether a key would change the value of a closed list. The browser and the list would take each arrow key as a
 * choice, and each choice is a command that undo lists.
 */
function changesClosedList({ key, target, altKey }: KeyboardEvent): boolean {
  if (altKey || !(target instanceof HTMLElement)) return false;
  // While a browser's own list is open, the arrow keys move in it.
  if (target instanceof HTMLSelectElement) return ARROWS.includes(key) && !isOpen(target);
  return (key === "ArrowLeft" || key === "ArrowRight") && target.closest("[aria-haspopup=listbox]") !== null;
}

/** Add the keyboard listener to a page; return a function that removes it. */
export function listenToKeys(page: Window, handlers: KeyboardHandlers): () => void {
  /** Movements of the held keys by physical key, because the letter of a key changes with Shift. */
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
    if (changesClosedList(event)) {
      event.preventDefault();
      event.stopPropagation();
      if (event.target instanceof HTMLSelectElement) event.target.showPicker();
      return;
    }
    const binding = (handlers.inTask() ? bindingOf(event, ["task"]) : null) ?? bindingOf(event);
    if (binding === null) return;
    const focus = focusKind(event.target);
    // Escape first deactivates the tool, whatever has the focus. The text of a focused field and the enlarged view do
    // not change.
    const putsDown = event.key === "Escape" && handlers.holdsTool() && !closesFirst(event.target);
    if (!takesKey(focus, event) && !putsDown) return;
    if (binding.command.kind === "press" && !handlers.isAvailable(binding.command.action)) return;
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
  // A window without focus receives no keyup event. Release the held keys, or the tip would continue to move.
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
