/** Actions of keys in a window that only watches. */

import type { Action } from "./keymap";

/** Actions that change only what this window shows. */
export const WATCHERS_ACTIONS: ReadonlySet<Action> = new Set<Action>([
  "crosshair_to_tip",
  "find_branch",
  "history",
  "key_card",
  "leave",
  "next_cut",
  "next_slab",
  "next_xray",
  "swap_outside",
  "toggle_outline",
  "toggle_route_line",
  "toggle_tone",
  "wall_point",
  "window_airway",
  "window_bone",
  "window_lung",
  "window_mediastinum",
]);
