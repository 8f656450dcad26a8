/** Where a planar picture lies in its plane, and where it lies after a zoom or a pan. */

import { add, scale, type Vec3 } from "./vec";

export interface FlatPlace {
  /** Of a pixel that is asked of the server. */
  readonly mmPerPx: number;
  readonly middle: Vec3;
}

/** Unit directions of the screen in the patient. */
export interface FlatAxes {
  readonly right: Vec3;
  readonly down: Vec3;
}

const moved = (place: FlatPlace, axes: FlatAxes, rightMm: number, downMm: number): Vec3 =>
  add(place.middle, add(scale(axes.right, rightMm), scale(axes.down, downMm)));

/** Scaled about a place of the picture, pixels from its middle: what lies there stays there. */
export function zoomedAbout(
  place: FlatPlace,
  axes: FlatAxes,
  mmPerPx: number,
  about: { right: number; down: number },
): FlatPlace {
  const change = place.mmPerPx - mmPerPx;
  return { mmPerPx, middle: moved(place, axes, about.right * change, about.down * change) };
}

/** Moved with the hand by so many pixels: what lay under it stays under it. */
export function panned(place: FlatPlace, axes: FlatAxes, px: { right: number; down: number }): FlatPlace {
  return { ...place, middle: moved(place, axes, -px.right * place.mmPerPx, -px.down * place.mmPerPx) };
}
