/** Marks at the clicked points of the airway wall, in all views. The marks stay at fixed patient positions. */

import { mm } from "../state/format";
import { type Geometry, pixelFromLps } from "../state/projection";
import { distance } from "../state/vec";
import { INK, type Ink, label, line, type ScreenPoint } from "./ink";
import type { Scene } from "./scene";
import type { Viewport } from "./viewport";

/**
 * Distance of a wall point from the lens, mm, beyond which another wall most likely hides the point in the airway view.
 */
const FAR_MM = 60;
/** Opacity of the marks of points that are not near. */
const FAINT = 0.35;
const ARM_PX = 6;
/** Distance between two marks, px, below which no label is drawn, because it would cover the marks. */
const LABEL_FROM_PX = 70;
/** Side of a view, px, below which the marks are smaller. */
const SMALL_CELL_PX = 400;
const GAP_PX = 2.5;

/**
 * Draw the marks of the clicked wall points. `isNear` returns whether a point at a depth (behind a plane, or in front
 * of a camera) is visible.
 */
export function paintWallMarks(
  ink: Ink,
  viewport: Viewport,
  geometry: Geometry,
  scene: Scene,
  isNear: (depthMm: number) => boolean = (depthMm) => depthMm <= FAR_MM,
): void {
  const marks = scene.wallPoints.map((lps) => {
    const seen = pixelFromLps(geometry, lps);
    return seen === null ? null : { at: viewport.screenAt(seen), near: isNear(seen.depthMm) };
  });
  const size = Math.min(viewport.size.width, viewport.size.height) < SMALL_CELL_PX ? 0.7 : 1;
  const [first, second] = marks;
  const [a, b] = scene.wallPoints;
  if (first != null && second != null && a !== undefined && b !== undefined) {
    const alpha = first.near && second.near ? 0.9 : FAINT;
    line(ink, [first.at, second.at], INK.halo, 3.5, 0.6 * alpha);
    line(ink, [first.at, second.at], INK.text, 1.5, alpha);
    const span = Math.hypot(second.at.x - first.at.x, second.at.y - first.at.y);
    const middle = { x: (first.at.x + second.at.x) / 2, y: (first.at.y + second.at.y) / 2 - 10 };
    if (first.near && second.near && span > LABEL_FROM_PX)
      label(ink, mm(distance(a, b)), middle, { size: 12, bold: true });
  }
  for (const [index, mark] of marks.entries()) {
    if (mark !== null) wallMark(ink, mark.at, mark.near ? 1 : FAINT, index === marks.length - 1, size);
  }
}

/** Draw a mark: a cross with a free middle. The latest mark has a ring. */
function wallMark(ink: Ink, at: ScreenPoint, alpha: number, latest: boolean, size: number): void {
  for (const [colour, width] of [
    [INK.halo, 4],
    [INK.text, 1.75],
  ] as const) {
    for (const [dx, dy] of [
      [1, 1],
      [1, -1],
      [-1, 1],
      [-1, -1],
    ] as const) {
      const from = { x: at.x + dx * size * GAP_PX, y: at.y + dy * size * GAP_PX };
      line(ink, [from, { x: at.x + dx * size * ARM_PX, y: at.y + dy * size * ARM_PX }], colour, width, alpha);
    }
    if (!latest) continue;
    ink.save();
    ink.globalAlpha = alpha;
    ink.strokeStyle = colour;
    ink.lineWidth = width;
    ink.beginPath();
    ink.arc(at.x, at.y, size * (ARM_PX + 3), 0, 2 * Math.PI);
    ink.stroke();
    ink.restore();
  }
}
