/** Conversion of the layer lines that arrive with a picture to canvas paths. Corners between voxels are rounded. */

import type { LayerName } from "../state/lungs";
import type { PixelPoint } from "../state/projection";
import type { WireLayer } from "../wire/parse";
import { outlineLines } from "./outline-path";

/** A layer of a picture as canvas paths. */
export interface DrawnLayer {
  readonly layer: LayerName;
  readonly part: string;
  readonly path: Path2D;
  /**
   * Transform from the path's coordinates to picture pixels, in the argument order of the canvas method `transform`.
   */
  readonly place: readonly [number, number, number, number, number, number];
  readonly complete: boolean;
}

/** Return the layers of a received picture as canvas paths. */
export function drawnLayers(layers: readonly WireLayer[]): DrawnLayer[] {
  return layers.map(({ header, bytes }) => {
    const [a = 1, b = 0, c = 0, d = 1, e = 0, f = 0] = header.pixel_from_line;
    return {
      layer: header.layer,
      part: header.part,
      path: smoothPath(outlineLines(bytes)),
      place: [a, b, c, d, e, f],
      complete: header.complete,
    };
  });
}

/**
 * Return a smooth path through the middles of the pieces of the lines, because the corners of a mask are not more exact
 * than a voxel.
 */
function smoothPath(lines: readonly (readonly PixelPoint[])[]): Path2D {
  const path = new Path2D();
  for (const points of lines) {
    const ring = closedRing(points);
    if (ring === null) {
      points.forEach(({ column, row }, n) => {
        if (n === 0) path.moveTo(column, row);
        else path.lineTo(column, row);
      });
      continue;
    }
    const last = ring.at(-1);
    const [first] = ring;
    if (first === undefined || last === undefined) continue;
    const start = middle(last, first);
    path.moveTo(start.column, start.row);
    ring.forEach((corner, n) => {
      const to = middle(corner, ring[(n + 1) % ring.length] ?? first);
      path.quadraticCurveTo(corner.column, corner.row, to.column, to.row);
    });
    path.closePath();
  }
  return path;
}

/** Return the corners of a closed line, each once; null for an open line. */
export function closedRing(points: readonly PixelPoint[]): PixelPoint[] | null {
  const [first, last] = [points[0], points.at(-1)];
  const closes = first !== undefined && first.column === last?.column && first.row === last.row;
  return closes && points.length > 3 ? points.slice(0, -1) : null;
}

const middle = (a: PixelPoint, b: PixelPoint): PixelPoint => ({
  column: 0.5 * (a.column + b.column),
  row: 0.5 * (a.row + b.row),
});
