import { expect, it } from "vitest";
import { WATCHERS_ACTIONS } from "./watchers-actions";

it("A watcher has no key for an action that changes the case.", () => {
  for (const action of ["undo", "save", "devices", "arm_target", "auto_advance", "toggle_shape"] as const) {
    expect(WATCHERS_ACTIONS.has(action)).toBe(false);
  }
});
