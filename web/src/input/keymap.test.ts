import { describe, expect, it } from "vitest";
import { VIEW_NAMES } from "../state/view-table";
import { bindingOf, clashes, KEYMAP, type KeyPress, keyOf, placesOf, takesKey } from "./keymap";

const press = (key: string, change: Partial<KeyPress> = {}): KeyPress => ({
  key,
  ctrlKey: false,
  metaKey: false,
  altKey: false,
  shiftKey: false,
  ...change,
});

describe("table of keys", () => {
  it("bindingOf finds each binding by its key, also while Shift or Caps Lock is active.", () => {
    for (const binding of KEYMAP) {
      const event = press(binding.key, { ctrlKey: binding.ctrl ?? false, shiftKey: binding.shift ?? false });
      expect(bindingOf(event, [binding.place])).toBe(binding);
    }
    expect(bindingOf(press("W", { shiftKey: true }))?.label).toBe("W");
  });

  it("No key has two bindings in places that can apply at once.", () => {
    const conflicts = clashes(KEYMAP).map(([a, b]) => `${a.label}: ${a.place}, ${a.words}; ${b.place}, ${b.words}`);
    expect(conflicts).toEqual([]);
  });

  it("clashes() finds equal keys in overlapping places, but not in separate views, lists or Shift states.", () => {
    const taken = KEYMAP.find((binding) => binding.label === ".");
    if (taken === undefined) throw new Error("no key adds a key frame");
    // Regression: on the tri-plane the full stop also moved a plane.
    const found = clashes([taken, { ...taken, place: "tri-plane" }]);
    expect(found).toHaveLength(1);
    expect(
      clashes([
        { ...taken, place: "orbit", shift: true },
        { ...taken, place: "tri-plane" },
      ]),
    ).toHaveLength(1);
    expect(
      clashes([
        { ...taken, place: "brush" },
        { ...taken, place: "tri-plane" },
      ]),
    ).toHaveLength(1);
    expect(
      clashes([
        { ...taken, place: "plane" },
        { ...taken, place: "path" },
      ]),
    ).toEqual([]);
    expect(clashes([{ ...taken, place: "list" }, taken])).toEqual([]);
    expect(
      clashes([
        { ...taken, shift: false },
        { ...taken, shift: true },
      ]),
    ).toEqual([]);
  });

  it("Every view is a place of keys, and every place of a view binding belongs to a view.", () => {
    expect(VIEW_NAMES.map((view) => placesOf(view).at(-1))).toEqual(VIEW_NAMES.map(() => "picture"));
    const places = new Set(VIEW_NAMES.flatMap(placesOf));
    const ofPictures = KEYMAP.filter((binding) => binding.command.kind === "picture").map((binding) => binding.place);
    expect(new Set(ofPictures)).toEqual(places);
  });

  it("A key without a binding has no effect in Carina and remains with the browser.", () => {
    for (const key of ["5", "Tab", "F5", "PageDown", "Home", "Enter", "9"]) expect(bindingOf(press(key))).toBeNull();
    // The browser's Ctrl+S would save the web page, which does not contain the case, so Carina handles the key.
    for (const key of ["w", "s", "d", "f", "n", "p", "t"]) {
      if (key !== "s") expect(bindingOf(press(key, { ctrlKey: true })), `Ctrl+${key}`).toBeNull();
      expect(bindingOf(press(key, { altKey: true })), `Alt+${key}`).toBeNull();
    }
  });

  it("Ctrl+Z and Cmd+Z are undo, and Ctrl+Shift+Z is redo.", () => {
    const action = (change: Partial<KeyPress>) => {
      const command = bindingOf(press("z", change))?.command;
      return command?.kind === "press" ? command.action : null;
    };
    expect(action({ ctrlKey: true })).toBe("undo");
    expect(action({ ctrlKey: true, shiftKey: true })).toBe("redo");
    expect(action({ metaKey: true })).toBe("undo");
    expect(action({})).toBeNull();
  });

  it("The main actions have the keys that the README and the key card name.", () => {
    const label = (words: string) => KEYMAP.find((binding) => binding.words.startsWith(words))?.label;
    expect(label("Advance (hold")).toBe("W");
    expect(label("Withdraw")).toBe("S");
    expect(label("Tip up")).toBe("\u2191");
    expect(keyOf("auto_advance")).toBe("Space");
    expect(keyOf("toggle_mode")).toBe("M");
    expect(keyOf("level_horizon")).toBe("H");
    expect(keyOf("flip_operator")).toBe("F");
    expect(keyOf("crosshair_to_tip")).toBe("C");
    expect(keyOf("swap_outside")).toBe("T");
  });
});

describe("takesKey", () => {
  it("A text field receives every key.", () => {
    for (const binding of KEYMAP) expect(takesKey("typing", press(binding.key))).toBe(false);
  });

  it("Lists and sliders receive the arrow keys, and buttons receive the space bar.", () => {
    expect(takesKey("arrows", press("ArrowUp"))).toBe(false);
    expect(takesKey("arrows", press("w"))).toBe(true);
    expect(takesKey("button", press(" "))).toBe(false);
    expect(takesKey("button", press("ArrowUp"))).toBe(true);
    expect(takesKey("button", press("Enter", { ctrlKey: true }))).toBe(true);
  });
});
