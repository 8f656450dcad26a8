/** Overlay of a tracked pen's tip, with the first line of the path's text while the path leads to the pen. */

import { type Geometry, pixelFromLps } from "../state/projection";
import { INK, type Ink, NamePlaces, penMark } from "./ink";
import type { Scene } from "./scene";
import type { Viewport } from "./viewport";

/** Draw the mark and the text of a tracked pen's tip. */
export function paintPen(
  ink: Ink,
  viewport: Viewport,
  geometry: Geometry,
  scene: Scene,
  inPlane: (depthMm: number) => boolean,
): void {
  if (scene.pen === null) return;
  const seen = pixelFromLps(geometry, scene.pen.lps);
  if (seen === null) return;
  const at = viewport.screenAt(seen);
  const near = inPlane(seen.depthMm);
  penMark(ink, at, near);
  const names = new NamePlaces();
  if (near) scene.pen.words.some((words) => names.name(ink, words, { x: at.x, y: at.y + 8 }, INK.text, viewport.size));
}
