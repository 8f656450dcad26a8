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

describe("the keys", () => {
  it("each find their own binding, with Shift or Caps Lock held too", () => {
    for (const binding of KEYMAP) {
      const event = press(binding.key, { ctrlKey: binding.ctrl ?? false, shiftKey: binding.shift ?? false });
      expect(bindingOf(event, [binding.place])).toBe(binding);
    }
    expect(bindingOf(press("W", { shiftKey: true }))?.label).toBe("W");
  });

  it("never mean two things where both hold at once", () => {
    const said = clashes(KEYMAP).map(([a, b]) => `${a.label}: ${a.place}, ${a.words}; ${b.place}, ${b.words}`);
    expect(said).toEqual([]);
  });

  it("that clash are found: with Shift or without, in a kind of picture and in all, but not in two lists", () => {
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

  it("hold in places that each picture is", () => {
    expect(VIEW_NAMES.map((view) => placesOf(view).at(-1))).toEqual(VIEW_NAMES.map(() => "picture"));
    const places = new Set(VIEW_NAMES.flatMap(placesOf));
    const ofPictures = KEYMAP.filter((binding) => binding.command.kind === "picture").map((binding) => binding.place);
    expect(new Set(ofPictures)).toEqual(places);
  });

  it("that are not Carina's stay with the browser", () => {
    for (const key of ["5", "Tab", "F5", "PageDown", "Home", "Enter", "9"]) expect(bindingOf(press(key))).toBeNull();
    // The browser's Ctrl+S would save the web page, which does not contain the case, so Carina handles the key.
    for (const key of ["w", "s", "d", "f", "n", "p", "t"]) {
      if (key !== "s") expect(bindingOf(press(key, { ctrlKey: true })), `Ctrl+${key}`).toBeNull();
      expect(bindingOf(press(key, { altKey: true })), `Alt+${key}`).toBeNull();
    }
  });

  it("tell undo from redo, on both kinds of keyboards", () => {
    const action = (change: Partial<KeyPress>) => {
      const command = bindingOf(press("z", change))?.command;
      return command?.kind === "press" ? command.action : null;
    };
    expect(action({ ctrlKey: true })).toBe("undo");
    expect(action({ ctrlKey: true, shiftKey: true })).toBe("redo");
    expect(action({ metaKey: true })).toBe("undo");
    expect(action({})).toBeNull();
  });

  it("are the ones that people know from the README and the key card", () => {
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

describe("focus", () => {
  it("keeps every key while typing", () => {
    for (const binding of KEYMAP) expect(takesKey("typing", press(binding.key))).toBe(false);
  });

  it("leaves the arrows to lists and sliders, and the space bar to buttons", () => {
    expect(takesKey("arrows", press("ArrowUp"))).toBe(false);
    expect(takesKey("arrows", press("w"))).toBe(true);
    expect(takesKey("button", press(" "))).toBe(false);
    expect(takesKey("button", press("ArrowUp"))).toBe(true);
    expect(takesKey("button", press("Enter", { ctrlKey: true }))).toBe(true);
  });
});
