/** Actions of keys that are possible during an attempt at a task and during a quiz. */

import type { Action } from "./keymap";

/**
 * Actions that change only the picture. The others would end the attempt, fly by themselves, change the case, or open
 * what the task hides; the buttons of the window end an attempt.
 */
export const TRAINING_ACTIONS: ReadonlySet<Action> = new Set<Action>([
  "flip_operator",
  "full_screen",
  "key_card",
  "leave",
  "level_horizon",
  "lock_mouse",
  "pause_task",
  "reset_look",
  "toggle_route_line",
  "toggle_shape",
]);
