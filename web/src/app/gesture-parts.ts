/** Constants and functions shared by the gestures of all views. */

import type { PictureGesture } from "../input/keymap";
import type { PointerHandlers } from "../input/pointer";
import { greyWindow } from "../state/app-state";
import type { Workstation } from "./workstation";

/** Rotation of the view per px of drag, degrees. */
export const ORBIT_DEG_PER_PX = 0.5;
/** Rotation of the view per key press, degrees. */
export const ORBIT_KEY_DEG = 5;
/** Natural logarithm of the zoom factor per px of scrolling. */
export const ZOOM_PER_PX = 0.0015;
/** Scrolling, px, that one press of a zoom key corresponds to. */
export const ZOOM_KEY_PX = 120;
const WINDOW_HU_PER_PX = 3;

/** Gestures of a view. */
export interface Gestures {
  pointer: PointerHandlers;
  /** Handle a key; return false if it has no effect in this view, which leaves the key to the browser. */
  key?(does: PictureGesture): boolean;
}

/** Change the grey-value window by a drag. */
export function dragWindow(station: Workstation, moved: { dx: number; dy: number }): void {
  const window = greyWindow(station.state);
  // The drag is finer for volumes that are not in HU and span few grey levels.
  const range = station.state.session?.case?.value_range;
  const perPx =
    range === undefined ? WINDOW_HU_PER_PX : Math.min(WINDOW_HU_PER_PX, ((range[1] ?? 0) - (range[0] ?? 0)) / 500);
  station.sendSoon({
    type: "set_window",
    width_hu: Math.min(Math.max(window.width_hu + moved.dx * perPx, 1), 65_536),
    level_hu: Math.min(Math.max(window.level_hu - moved.dy * perPx, -32_768), 32_768),
  });
}
