/** Queries of the table of keys: label, binding, valid places, and conflicts. */

import type { ViewName } from "../wire/messages";
import { VIEWS } from "../wire/views";
import { type Action, type Binding, type HoldAxis, KEYMAP, type KeyGroup, type KeyPlace, PLACES } from "./key-table";

export type { Action, HoldAxis, PictureGesture } from "./key-table";
export { KEYMAP, WINDOWS } from "./key-table";

/** Return the label of the key of an action, for tooltips. */
export function keyOf(action: Action): string {
  return KEYMAP.find((b) => b.command.kind === "press" && b.command.action === action)?.label ?? "";
}

/** Return the label of the key that moves the tip along or about an axis while held. */
export function keyOfHold(axis: HoldAxis, sign: 1 | -1): string {
  return (
    KEYMAP.find(({ command }) => command.kind === "hold" && command.axis === axis && command.sign === sign)?.label ?? ""
  );
}

/** The fields of a keyboard event that select a binding. */
export interface KeyPress {
  readonly key: string;
  readonly ctrlKey: boolean;
  readonly metaKey: boolean;
  readonly altKey: boolean;
  readonly shiftKey: boolean;
}

/**
 * Return the binding of a key press in the given places, tried in order; null for a key without a binding, which the
 * browser receives.
 */
export function bindingOf(event: KeyPress, places: readonly KeyPlace[] = PAGE_PLACES): Binding | null {
  if (event.altKey) return null;
  const ctrl = event.ctrlKey || event.metaKey;
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  return (
    KEYMAP.find(
      (b) =>
        places.includes(b.place) &&
        b.key === key &&
        (b.ctrl ?? false) === ctrl &&
        (b.shift === undefined || b.shift === event.shiftKey),
    ) ?? null
  );
}

/** Contexts whose keys the listener of the whole page handles. */
const PAGE_PLACES: readonly KeyPlace[] = ["page", "brush"];

/** Return the context of a view and the more general contexts that contain it. */
export function placesOf(view: ViewName): readonly KeyPlace[] {
  const { zoom, pick } = VIEWS[view];
  switch (zoom) {
    case "slice":
    case "extent":
      return ["plane", "picture"];
    case "path":
    case "carm":
      return [zoom, "picture"];
    case "orbit":
      return pick === "planes" ? ["tri-plane", "orbit", "picture"] : ["orbit", "picture"];
    case "tip":
    case null:
      return ["picture"];
  }
}

/** Kind of the focused element, by the keys that the element uses itself. */
export type FocusKind = "page" | "typing" | "arrows" | "button";

/**
 * Return whether the page handles a key while an element has the focus. A text field uses every key; other elements use
 * some keys.
 */
export function takesKey(focus: FocusKind, event: KeyPress): boolean {
  switch (focus) {
    case "page":
      return true;
    case "typing":
      return false;
    case "arrows":
      return bindingOf(event, ["list"]) === null;
    case "button":
      return bindingOf(event, ["button"]) === null;
  }
}

/** Return whether keys of two places can be active together. Only one view, list, button or field can have focus. */
export function holdTogether(a: KeyPlace, b: KeyPlace): boolean {
  if (a === b || isWithin(a, b) || isWithin(b, a)) return true;
  return !(takesFocus(a) && takesFocus(b));
}

const isWithin = (inner: KeyPlace, outer: KeyPlace): boolean => {
  const { within } = PLACES[inner];
  return within !== null && (within === outer || isWithin(within, outer));
};
const takesFocus = (place: KeyPlace): boolean =>
  place !== "page" && place !== "brush" && place !== "task" && place !== "question";

/** Return whether the keys of one context are intended to take precedence over those of the other. */
const isOver = (a: KeyPlace, b: KeyPlace): boolean =>
  (PLACES[a].over as readonly KeyPlace[]).some((under) => under === b || isWithin(b, under));

const both = (a: boolean | undefined, b: boolean | undefined): boolean => a === undefined || b === undefined || a === b;

/** Return pairs of bindings that use the same key in places that can apply at once. */
export function clashes(table: readonly Binding[]): [Binding, Binding][] {
  return table.flatMap((a, index) =>
    table
      .slice(index + 1)
      .filter(
        (b) =>
          a.key === b.key &&
          (a.ctrl ?? false) === (b.ctrl ?? false) &&
          both(a.shift, b.shift) &&
          holdTogether(a.place, b.place) &&
          !isOver(a.place, b.place) &&
          !isOver(b.place, a.place),
      )
      .map((b): [Binding, Binding] => [a, b]),
  );
}

const GROUPS: readonly KeyGroup[] = ["Fly", "Look", "Plan", "Airways", "Views", "Help"];

/** Keep the first binding of those with the same label, so that the display has one line per label. */
const lines = (bindings: readonly Binding[]): readonly Binding[] =>
  bindings.filter(({ label }, index) => bindings.findIndex((other) => other.label === label) === index);

/** Return all keys for display: keys that are valid anywhere by group, the others by place. */
export function keySections(): readonly { readonly title: string; readonly rows: readonly Binding[] }[] {
  return [
    ...GROUPS.map((group) => ({ title: group, rows: lines(KEYMAP.filter((binding) => binding.group === group)) })),
    ...(Object.keys(PLACES) as KeyPlace[]).map((place) => ({
      title: PLACES[place].title,
      rows: lines(KEYMAP.filter((binding) => binding.place === place && binding.group === undefined)),
    })),
  ].filter(({ rows }) => rows.length > 0);
}
