/** Position of a planar view in its plane, and the change of the position by zoom and pan. */

import { add, scale, type Vec3 } from "./vec";

/** Centre (LPS mm) and scale of a planar view. */
export interface FlatPlace {
  /** Scale: millimetres per pixel of the requested picture. */
  readonly mmPerPx: number;
  readonly middle: Vec3;
}

/** Unit vectors of the picture's axes (right, down) in patient space, LPS. */
export interface FlatAxes {
  readonly right: Vec3;
  readonly down: Vec3;
}

const moved = (place: FlatPlace, axes: FlatAxes, rightMm: number, downMm: number): Vec3 =>
  add(place.middle, add(scale(axes.right, rightMm), scale(axes.down, downMm)));

/** Return the position after a zoom that keeps one picture point fixed, given in px from the middle of the picture. */
export function zoomedAbout(
  place: FlatPlace,
  axes: FlatAxes,
  mmPerPx: number,
  about: { right: number; down: number },
): FlatPlace {
  const change = place.mmPerPx - mmPerPx;
  return { mmPerPx, middle: moved(place, axes, about.right * change, about.down * change) };
}

/** Return the position after a pan by a number of px; the picture moves with the hand. */
export function panned(place: FlatPlace, axes: FlatAxes, px: { right: number; down: number }): FlatPlace {
  return { ...place, middle: moved(place, axes, -px.right * place.mmPerPx, -px.down * place.mmPerPx) };
}
