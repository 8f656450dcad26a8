/** Over the outside pictures (tree, tri-plane): the route, the targets and the tip as their camera sees them. */

import { geometryOf, pixelFromLps, projectLine } from "../state/projection";
import { add, scale } from "../state/vec";
import { INK, type Ink, line, NamePlaces, targetMark, tipMark } from "./ink";
import { paintLetters } from "./overlay-flat";
import type { Scene } from "./scene";
import type { Viewport } from "./viewport";
import { paintWallMarks } from "./wall-marks";

/** The length of the look arrow in the patient. */
const LOOK_MM = 12;

export function paintSeen(ink: Ink, viewport: Viewport, scene: Scene): void {
  const { header } = viewport;
  if (header === null) return;
  const geometry = geometryOf(header);
  if (geometry === null) return;
  if (scene.routeLineVisible) {
    for (const run of projectLine(geometry, scene.routePoints)) {
      const points = run.map((point) => viewport.screenAt(point));
      line(ink, points, INK.halo, 4, 0.6);
      line(ink, points, INK.accent, 2);
    }
  }
  const names = new NamePlaces();
  for (const target of scene.targets) {
    const seen = pixelFromLps(geometry, target.lps);
    if (seen === null) continue;
    const at = viewport.screenAt(seen);
    const colour = target.reachable ? INK.accent : INK.warning;
    targetMark(ink, at, colour, 1);
    names.name(ink, target.name, at, colour, viewport.size);
  }
  paintWallMarks(ink, viewport, geometry, scene, () => true);
  if (scene.tip !== null) {
    const seen = pixelFromLps(geometry, scene.tip.position);
    const ahead = pixelFromLps(geometry, add(scene.tip.position, scale(scene.tip.forward, LOOK_MM)));
    if (seen !== null) {
      const at = viewport.screenAt(seen);
      const to = ahead === null ? null : viewport.screenAt(ahead);
      tipMark(ink, at, to === null ? null : { x: to.x - at.x, y: to.y - at.y }, true);
    }
  }
  paintLetters(ink, viewport, geometry);
}
