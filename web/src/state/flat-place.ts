/** Position of a planar view in its plane, and its change by zoom and pan. */

import { add, scale, type Vec3 } from "./vec";

/** Centre and scale of a planar view. */
export interface FlatPlace {
  /** Millimetres per pixel of the requested picture. */
  readonly mmPerPx: number;
  readonly middle: Vec3;
}

/** Unit vectors of the screen axes in patient space. */
export interface FlatAxes {
  readonly right: Vec3;
  readonly down: Vec3;
}

const moved = (place: FlatPlace, axes: FlatAxes, rightMm: number, downMm: number): Vec3 =>
  add(place.middle, add(scale(axes.right, rightMm), scale(axes.down, downMm)));

/** Zoom about a fixed place of the picture, given in pixels from its middle. */
export function zoomedAbout(
  place: FlatPlace,
  axes: FlatAxes,
  mmPerPx: number,
  about: { right: number; down: number },
): FlatPlace {
  const change = place.mmPerPx - mmPerPx;
  return { mmPerPx, middle: moved(place, axes, about.right * change, about.down * change) };
}

/** Pan by a number of pixels, so that the picture follows the hand. */
export function panned(place: FlatPlace, axes: FlatAxes, px: { right: number; down: number }): FlatPlace {
  return { ...place, middle: moved(place, axes, -px.right * place.mmPerPx, -px.down * place.mmPerPx) };
}
