/** Conversion of the lumen outline that arrives with a picture to a canvas path. */

import type { PixelPoint } from "../state/projection";

/** Number of units per pixel in the protocol's coordinates. */
const PARTS = 16;

/** Return the lines of an outline in pixels of its picture. The protocol's parser has validated the bytes. */
export function outlineLines(bytes: Uint8Array): PixelPoint[][] {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const lines: PixelPoint[][] = [];
  let at = 0;
  while (at + 2 <= bytes.byteLength) {
    const count = view.getUint16(at, true);
    at += 2;
    const points: PixelPoint[] = [];
    for (let n = 0; n < count; n += 1, at += 4) {
      points.push({ column: view.getUint16(at, true) / PARTS, row: view.getUint16(at + 2, true) / PARTS });
    }
    lines.push(points);
  }
  return lines;
}

/** Return the outline as one canvas path, in pixels of its picture. */
export function outlinePath(bytes: Uint8Array): Path2D {
  const path = new Path2D();
  for (const points of outlineLines(bytes)) {
    points.forEach(({ column, row }, n) => {
      if (n === 0) path.moveTo(column, row);
      else path.lineTo(column, row);
    });
    const [first, last] = [points[0], points.at(-1)];
    if (first !== undefined && first.column === last?.column && first.row === last.row) path.closePath();
  }
  return path;
}
