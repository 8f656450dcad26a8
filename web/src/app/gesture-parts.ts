/** What the gestures of all pictures share. */

import type { PictureGesture } from "../input/keymap";
import type { PointerHandlers } from "../input/pointer";
import { greyWindow } from "../state/app-state";
import type { Workstation } from "./workstation";

export const ORBIT_DEG_PER_PX = 0.5;
export const ORBIT_KEY_DEG = 5;
export const ZOOM_PER_PX = 0.0015;
export const ZOOM_KEY_PX = 120;
const WINDOW_HU_PER_PX = 3;

export interface Gestures {
  pointer: PointerHandlers;
  /** False where it means nothing here: then the key stays with the browser. */
  key?(does: PictureGesture): boolean;
}

export function dragWindow(station: Workstation, moved: { dx: number; dy: number }): void {
  const window = greyWindow(station.state);
  // Volumes that are not HU may span a few grey levels only: then the drag is finer.
  const range = station.state.session?.case?.value_range;
  const perPx =
    range === undefined ? WINDOW_HU_PER_PX : Math.min(WINDOW_HU_PER_PX, ((range[1] ?? 0) - (range[0] ?? 0)) / 500);
  station.sendSoon({
    type: "set_window",
    width_hu: Math.min(Math.max(window.width_hu + moved.dx * perPx, 1), 65_536),
    level_hu: Math.min(Math.max(window.level_hu - moved.dy * perPx, -32_768), 32_768),
  });
}
