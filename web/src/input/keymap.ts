/** What a key press means: the table of keys, asked. */

import type { ViewName } from "../wire/messages";
import { VIEWS } from "../wire/views";
import { type Action, type Binding, type HoldAxis, KEYMAP, type KeyGroup, type KeyPlace, PLACES } from "./key-table";

export type { Action, HoldAxis, PictureGesture } from "./key-table";
export { KEYMAP, WINDOWS } from "./key-table";

/** The printed key of an action, for tooltips. */
export function keyOf(action: Action): string {
  return KEYMAP.find((b) => b.command.kind === "press" && b.command.action === action)?.label ?? "";
}

/** The same of a key that is held. */
export function keyOfHold(axis: HoldAxis, sign: 1 | -1): string {
  return (
    KEYMAP.find(({ command }) => command.kind === "hold" && command.axis === axis && command.sign === sign)?.label ?? ""
  );
}

export interface KeyPress {
  readonly key: string;
  readonly ctrlKey: boolean;
  readonly metaKey: boolean;
  readonly altKey: boolean;
  readonly shiftKey: boolean;
}

/** The binding of a key press where it holds, or null: then the key belongs to the browser and is not touched. */
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

/** Whose keys the whole page listens to. */
const PAGE_PLACES: readonly KeyPlace[] = ["page", "brush"];

/** The kind of a picture, as far as its keys go, and what it is a kind of. */
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

/** What has the focus, as far as keys care. */
export type FocusKind = "page" | "typing" | "arrows" | "button";

/** Whether the page takes a key while something has the focus. Typing keeps every key; the others keep their own. */
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

/** Whether two places can hold at once: one picture has the focus, or one list, button or field, or none. */
export function holdTogether(a: KeyPlace, b: KeyPlace): boolean {
  if (a === b || isWithin(a, b) || isWithin(b, a)) return true;
  return !(takesFocus(a) && takesFocus(b));
}

const isWithin = (inner: KeyPlace, outer: KeyPlace): boolean => {
  const { within } = PLACES[inner];
  return within !== null && (within === outer || isWithin(within, outer));
};
const takesFocus = (place: KeyPlace): boolean => place !== "page" && place !== "brush" && place !== "question";

/** Whether one place's keys are taken before the other's, by intention. */
const isOver = (a: KeyPlace, b: KeyPlace): boolean =>
  (PLACES[a].over as readonly KeyPlace[]).some((under) => under === b || isWithin(b, under));

const both = (a: boolean | undefined, b: boolean | undefined): boolean => a === undefined || b === undefined || a === b;

/** Pairs of bindings of which one would take the other's key. */
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

/** One line for keys that do one thing together. */
const lines = (bindings: readonly Binding[]): readonly Binding[] =>
  bindings.filter(({ label }, index) => bindings.findIndex((other) => other.label === label) === index);

/** All keys as a person reads them: those that hold anywhere by what they are for, the others by their place. */
export function keySections(): readonly { readonly title: string; readonly rows: readonly Binding[] }[] {
  return [
    ...GROUPS.map((group) => ({ title: group, rows: lines(KEYMAP.filter((binding) => binding.group === group)) })),
    ...(Object.keys(PLACES) as KeyPlace[]).map((place) => ({
      title: PLACES[place].title,
      rows: lines(KEYMAP.filter((binding) => binding.place === place && binding.group === undefined)),
    })),
  ].filter(({ rows }) => rows.length > 0);
}
