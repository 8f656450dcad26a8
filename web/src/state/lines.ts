/** Geometry of the curved pictures along the route: each row is a straight line in patient space. */

import type { PictureLines } from "../wire/messages";
import type { PixelPoint } from "./projection";
import { add, asVec3, distance, dot, lerp, scale, sub, type Vec3 } from "./vec";

/** Geometry of a curved picture, in which each row is a straight line in patient space. */
export interface LinesGeometry {
  readonly rows: readonly number[];
  readonly start: readonly Vec3[];
  readonly step: readonly Vec3[];
  readonly pathMm: readonly number[];
  readonly pathColumn: readonly number[];
  readonly mmPerPx: number;
}

/** Return the geometry of a curved picture from its header; null if the header has no lines or too few rows. */
export function linesOf(lines: PictureLines | null): LinesGeometry | null {
  if (lines === null || lines.row.length < 2) return null;
  return {
    rows: lines.row,
    start: lines.start_lps.map((point) => asVec3(point)),
    step: lines.step_lps.map((point) => asVec3(point)),
    pathMm: lines.path_mm,
    pathColumn: lines.path_column,
    mmPerPx: lines.mm_per_px,
  };
}

/**
 * Return the position of a value in an ascending list: the index of the element before it, and the fraction to the next
 * element. Both are clamped to the list.
 */
function placeIn(ascending: readonly number[], value: number): { index: number; t: number } {
  let low = 0;
  let high = ascending.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if ((ascending[middle] ?? 0) <= value) low = middle;
    else high = middle;
  }
  const from = ascending[low] ?? 0;
  const gap = (ascending[high] ?? from) - from;
  return { index: low, t: gap > 0 ? Math.min(Math.max((value - from) / gap, 0), 1) : 0 };
}

const mix = (list: readonly number[], { index, t }: { index: number; t: number }): number => {
  const from = list[index] ?? 0;
  return from + ((list[index + 1] ?? from) - from) * t;
};

const mixPoints = (list: readonly Vec3[], { index, t }: { index: number; t: number }): Vec3 => {
  const from = list[index] ?? [0, 0, 0];
  return lerp(from, list[index + 1] ?? from, t);
};

/** Return the patient point (LPS mm) of a pixel in a curved picture. */
export function lpsAt(geometry: LinesGeometry, pixel: PixelPoint): Vec3 {
  const place = placeIn(geometry.rows, pixel.row);
  return add(mixPoints(geometry.start, place), scale(mixPoints(geometry.step, place), pixel.column));
}

/** Number of rows of a curved reformation over which the direction of the route is computed. */
const LOCAL_ROWS = 12;

/**
 * Return the patient directions of a curved picture: `right` and `up` at the beginning of the route, `down` at its end.
 * The route may bend, so that each direction is valid only at its end.
 */
export function axesAt(geometry: LinesGeometry): { right: Vec3; up: Vec3; down: Vec3 } {
  const first = pixelOfPath(geometry, geometry.pathMm[0] ?? 0)?.row ?? 0;
  const last = pixelOfPath(geometry, geometry.pathMm.at(-1) ?? 0)?.row ?? 0;
  const along = (row: number): Vec3 =>
    lpsAt(geometry, { column: mix(geometry.pathColumn, placeIn(geometry.rows, row)), row });
  return {
    right: mixPoints(geometry.step, placeIn(geometry.rows, first)),
    up: sub(along(first), along(Math.min(first + LOCAL_ROWS, last))),
    down: sub(along(last), along(Math.max(last - LOCAL_ROWS, first))),
  };
}

/** Return the position along the route, mm, that a picture row shows. */
export function pathMmAt(geometry: LinesGeometry, row: number): number {
  return mix(geometry.pathMm, placeIn(geometry.rows, row));
}

/** Return the pixel of a position along the route; null for a position outside the picture. */
export function pixelOfPath(geometry: LinesGeometry, pathMm: number): PixelPoint | null {
  const first = geometry.pathMm[0] ?? 0;
  const last = geometry.pathMm.at(-1) ?? 0;
  // Tolerance of 0.01 mm, because the wire rounds positions.
  if (pathMm < first - 0.01 || pathMm > last + 0.01) return null;
  // Straight rows beyond an end of the route have the position of that end. Of the rows with the same position, select
  // the last one at the top and the first one at the bottom.
  let index = 0;
  while (index < geometry.pathMm.length - 2 && (geometry.pathMm[index + 1] ?? 0) <= pathMm) index += 1;
  if (pathMm >= last) index = Math.max(geometry.pathMm.findIndex((mm) => mm >= last) - 1, 0);
  const from = geometry.pathMm[index] ?? 0;
  const gap = (geometry.pathMm[index + 1] ?? from) - from;
  const place = { index, t: gap > 0 ? Math.min(Math.max((pathMm - from) / gap, 0), 1) : 0 };
  return { column: mix(geometry.pathColumn, place), row: mix(geometry.rows, place) };
}

/** Return the pixel nearest to a patient point, and the distance of the point from that pixel's point, mm. */
export function nearestPixel(geometry: LinesGeometry, lps: Vec3): PixelPoint & { awayMm: number } {
  let best = { column: 0, row: 0, awayMm: Number.POSITIVE_INFINITY };
  const first = geometry.rows[0] ?? 0;
  const last = geometry.rows.at(-1) ?? 0;
  for (let row = first; row <= last; row += 1) {
    const place = placeIn(geometry.rows, row);
    const start = mixPoints(geometry.start, place);
    const step = mixPoints(geometry.step, place);
    const column = Math.max(dot(sub(lps, start), step) / dot(step, step), 0);
    const awayMm = distance(lps, add(start, scale(step, column)));
    if (awayMm < best.awayMm) best = { column, row, awayMm };
  }
  return best;
}
