/** Positions of the lines and marks in the picture of a CT's slices. */

import type { CaseInfo } from "../wire/messages";

/** A mark below the line of slices. */
export interface SliceMark {
  /** Index k of the interpolated slice. */
  readonly slice: number;
  readonly x: number;
  readonly width: number;
}

/** Lines and marks of the picture, in px from its left edge. */
export interface SliceTicks {
  readonly measuredPx: readonly number[];
  readonly interpolatedPx: readonly SliceMark[];
  /** Horizontal distance of the two ends of a line: the gantry tilt. */
  readonly leanPx: number;
}

const LINE_PX = 22;
const MARGIN_PX = 8;
const MIN_MARK_PX = 2;

/** Return the lines of the slices of the files and the marks of interpolated slices in a picture of a given width. */
export function sliceTicks(
  info: Pick<CaseInfo, "shape_zyx" | "slice_places" | "interpolated_slices" | "tilt_deg">,
  width: number,
): SliceTicks {
  const last = Math.max((info.shape_zyx[0] ?? 1) - 1, 1);
  const step = (width - 2 * MARGIN_PX) / last;
  const at = (place: number) => MARGIN_PX + place * step;
  const mark = Math.max(step, MIN_MARK_PX);
  return {
    measuredPx: info.slice_places.map(at),
    interpolatedPx: info.interpolated_slices.map((slice) => ({ slice, x: at(slice) - mark / 2, width: mark })),
    leanPx: info.tilt_deg === null ? 0 : LINE_PX * Math.tan((info.tilt_deg * Math.PI) / 180),
  };
}
