/** Shape of the airway picture on the screen: the full frame, or the shape of a bronchoscope's monitor image. */

import type { Outline } from "../wire/messages";
import type { Ink, Rect, ScreenPoint } from "./ink";

/** Shape of the airway picture on the screen. */
export type Shape = "fill" | "round" | "octagon";

/** Half the side of an octagon, in half widths of the octagon. */
const HALF_SIDE = Math.tan(Math.PI / 8);

/** Return the picture's shape for an outline setting. */
export function shapeOf(outline: Outline): Shape {
  return outline === "none" ? "fill" : outline;
}

/** Corners of an octagon, clockwise, in half widths from its middle. */
const CORNERS: readonly (readonly [number, number])[] = [
  [HALF_SIDE, -1],
  [1, -HALF_SIDE],
  [1, HALF_SIDE],
  [HALF_SIDE, 1],
  [-HALF_SIDE, 1],
  [-1, HALF_SIDE],
  [-1, -HALF_SIDE],
  [-HALF_SIDE, -1],
];

/** Begin a canvas path along the shape in a frame. */
export function traceOutline(ink: Ink, shape: Shape, frame: Rect): void {
  const half = frame.width / 2;
  const [x, y] = [frame.x + half, frame.y + frame.height / 2];
  ink.beginPath();
  if (shape === "fill") ink.rect(frame.x, frame.y, frame.width, frame.height);
  else if (shape === "round") ink.arc(x, y, half, 0, 2 * Math.PI);
  else for (const [dx, dy] of CORNERS) ink.lineTo(x + dx * half, y + dy * half);
  ink.closePath();
}

/** Return whether a screen point is inside the shape in a frame. */
export function isInside(shape: Shape, frame: Rect, at: ScreenPoint): boolean {
  const half = frame.width / 2;
  const dx = Math.abs(at.x - frame.x - half);
  const dy = Math.abs(at.y - frame.y - frame.height / 2);
  switch (shape) {
    case "fill":
      return dx <= half && dy <= frame.height / 2;
    case "round":
      return Math.hypot(dx, dy) <= half;
    case "octagon":
      return Math.max(dx, dy, (dx + dy) * Math.SQRT1_2) <= half;
  }
}

/** Return the shape as a CSS clip path. */
export function clipPathOf(shape: Shape): string {
  if (shape === "fill") return "none";
  if (shape === "round") return "circle(50%)";
  return `polygon(${CORNERS.map(([x, y]) => `${50 * (1 + x)}% ${50 * (1 + y)}%`).join(", ")})`;
}
