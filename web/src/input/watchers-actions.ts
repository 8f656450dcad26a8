/** Actions of keys that a window may use if it only watches another workstation. */

import type { Action } from "./keymap";

/** Actions that change only what their window shows, and not the case. */
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
