import { expect, it } from "vitest";
import { TRAINING_ACTIONS } from "./training-actions";

it("An attempt has no key for an action that ends it, flies by itself, or shows what the task hides.", () => {
  for (const action of [
    "auto_advance",
    "previous_fork",
    "toggle_mode",
    "way_left",
    "undo",
    "rename",
    "find_branch",
    "history",
    "key_frames",
    "devices",
    "swap_outside",
    "tool_cut",
    "arm_target",
  ] as const) {
    expect(TRAINING_ACTIONS.has(action)).toBe(false);
  }
});
