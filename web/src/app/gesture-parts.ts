/** Constants and functions shared by the gestures of all views. */

import type { PictureGesture } from "../input/keymap";
import { type PointerHandlers, ZOOM_PER_PX } from "../input/pointer";
import { greyWindow } from "../state/app-state";
import type { Workstation } from "./workstation";

export { ZOOM_PER_PX };

/** Rotation of the view per px of drag, degrees. */
export const ORBIT_DEG_PER_PX = 0.5;
/** Rotation of the view per key press, degrees. */
export const ORBIT_KEY_DEG = 5;
/** Scrolling, px, that zooms by as much as one press of a zoom key. */
export const ZOOM_KEY_PX = 120;
/** Change of the window's width or level per px of drag, HU. */
const WINDOW_HU_PER_PX = 3;

/** Handlers of the pointer and of the keys in one view. */
export interface Gestures {
  pointer: PointerHandlers;
  /**
   * Handle a key of a focused view. Return false if the key has no effect in this view, so that the browser receives
   * the key.
   */
  key?(does: PictureGesture): boolean;
}

/** Change the grey-value window by a drag: its width by the horizontal movement, its level by the vertical movement. */
export function dragWindow(station: Workstation, moved: { dx: number; dy: number }): void {
  const window = greyWindow(station.state);
  // Change the window in finer steps for volumes with few grey levels, which are usually not in HU.
  const range = station.state.session?.case?.value_range;
  const perPx =
    range === undefined ? WINDOW_HU_PER_PX : Math.min(WINDOW_HU_PER_PX, ((range[1] ?? 0) - (range[0] ?? 0)) / 500);
  station.sendSoon({
    type: "set_window",
    width_hu: Math.min(Math.max(window.width_hu + moved.dx * perPx, 1), 65_536),
    level_hu: Math.min(Math.max(window.level_hu - moved.dy * perPx, -32_768), 32_768),
  });
}
