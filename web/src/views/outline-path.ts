/** The outline of the lumen as it came with a picture, ready to be drawn. */

import type { PixelPoint } from "../state/projection";

/** Of a pixel in the wire's numbers. */
const PARTS = 16;

/** The lines of an outline in pixels of its picture; the wire's form is checked where it is read. */
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

/** One path in pixels of the picture, drawn again with each repaint. */
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
