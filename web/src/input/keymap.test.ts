import { describe, expect, it } from "vitest";
import { bindingOf, KEYMAP, type KeyPress, keyOf, takesKey } from "./keymap";

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
      expect(bindingOf(event)).toBe(binding);
    }
    expect(bindingOf(press("W", { shiftKey: true }))?.label).toBe("W");
  });

  it("are bound once each", () => {
    const seen = KEYMAP.map((binding) => `${binding.ctrl ?? false} ${binding.shift ?? "any"} ${binding.key}`);
    expect(new Set(seen).size).toBe(seen.length);
  });

  it("that are not Carina's stay with the browser", () => {
    for (const key of ["5", "Tab", "F5", "PageDown", "Home", "Enter", "9"]) expect(bindingOf(press(key))).toBeNull();
    for (const key of ["w", "s", "d", "f", "n", "p", "t"]) {
      expect(bindingOf(press(key, { ctrlKey: true })), `Ctrl+${key}`).toBeNull();
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
    for (const binding of KEYMAP) expect(takesKey("typing", binding.key)).toBe(false);
  });

  it("leaves the arrows to lists and sliders, and the space bar to buttons", () => {
    expect(takesKey("arrows", "ArrowUp")).toBe(false);
    expect(takesKey("arrows", "w")).toBe(true);
    expect(takesKey("button", " ")).toBe(false);
    expect(takesKey("button", "ArrowUp")).toBe(true);
  });
});
