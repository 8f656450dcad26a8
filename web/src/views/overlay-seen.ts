/**
 * Overlay of the outside views (tree, tri-plane, radiograph): route, targets and tip, projected by the camera of the
 * view.
 */

import { carmText } from "../state/format";
import { axesOf, geometryOf, pixelFromLps, projectLine, type SeenGeometry } from "../state/projection";
import { outlineOf } from "../state/tri-plane";
import { add, scale } from "../state/vec";
import { planeAcross } from "../state/view-table";
import { VIEWS } from "../wire/views";
import {
  INK,
  type Ink,
  label,
  line,
  NamePlaces,
  PLANE_COLOURS,
  type ScreenPoint,
  startMark,
  targetMark,
  tipMark,
} from "./ink";
import { paintCursorNote, paintLivePath, paintPreview } from "./overlay-cursor";
import { paintLetters } from "./overlay-flat";
import { paintStations } from "./overlay-layers";
import { paintLesionsOutside, paintPlannedTip } from "./overlay-lesion";
import { paintLobes, paintNames } from "./overlay-names";
import { paintPen } from "./overlay-pen";
import { paintActedOn, paintDrawn, paintTree } from "./overlay-tree";
import { paintVessels } from "./overlay-vessels";
import type { Scene } from "./scene";
import type { Viewport } from "./viewport";
import { paintWallMarks } from "./wall-marks";

/** Length of the arrow that shows the tip's viewing direction, mm. */
const LOOK_MM = 12;

/** Draw the overlay of an outside view. */
export function paintSeen(ink: Ink, viewport: Viewport, scene: Scene): void {
  const { header } = viewport;
  if (header === null) return;
  const geometry = geometryOf(header);
  if (geometry === null) return;
  const { pick, zoom } = VIEWS[header.view];
  if (pick === "planes" && geometry.kind === "seen") paintPlanes(ink, viewport, geometry, scene);
  if (zoom === "carm") paintAngles(ink, scene);
  const isTree = pick === "branch" && geometry.kind === "seen";
  if (isTree) paintVessels(ink, viewport, geometry, scene);
  if (isTree) paintLobes(ink, viewport, geometry, scene);
  paintTree(ink, viewport, geometry, scene, () => true);
  if (scene.routeLineVisible) {
    for (const run of scene.routeRuns.flatMap((points) => projectLine(geometry, points))) {
      const points = run.map((point) => viewport.screenAt(point));
      line(ink, points, INK.halo, 4, 0.6);
      line(ink, points, INK.accent, 2);
    }
  }
  paintLesionsOutside(ink, viewport, geometry, scene);
  paintActedOn(ink, viewport, geometry, scene, () => true);
  paintDrawn(ink, viewport, geometry, scene, () => true);
  paintLivePath(ink, viewport, geometry, scene, () => true);
  paintPreview(ink, viewport, geometry, scene, () => true);
  const names = new NamePlaces();
  if (scene.start !== null) {
    const seen = pixelFromLps(geometry, scene.start);
    if (seen !== null) startMark(ink, viewport.screenAt(seen), 1, names, viewport.size);
  }
  for (const target of scene.targets) {
    const seen = pixelFromLps(geometry, target.lps);
    if (seen === null) continue;
    const at = viewport.screenAt(seen);
    const colour = target.reachable ? INK.accent : INK.warning;
    if (!target.hasSize) targetMark(ink, at, colour, 1);
    names.name(ink, target.name, at, colour, viewport.size);
  }
  if (zoom === "carm") paintPlannedTip(ink, viewport, geometry, scene, names);
  if (isTree) {
    paintStations(ink, viewport, scene, names, (lps) => {
      const seen = pixelFromLps(geometry, lps);
      return seen === null ? null : { ...viewport.screenAt(seen), near: true };
    });
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
  paintPen(ink, viewport, geometry, scene, () => true);
  if (isTree) paintNames(ink, viewport, geometry, scene, names);
  paintLetters(ink, viewport, axesOf(geometry));
  paintCursorNote(ink, viewport, scene);
}

/**
 * Draw the edges of the three planes in the colours of the planes, with names. The plane that a drag would move has
 * stronger lines.
 */
function paintPlanes(ink: Ink, viewport: Viewport, geometry: SeenGeometry, scene: Scene): void {
  const { grid, crosshair } = scene;
  if (grid === null || crosshair === null) return;
  const names = new NamePlaces();
  for (const axis of [0, 1, 2] as const) {
    const name = planeAcross(axis);
    const over = scene.overPlane === name;
    const corners: ScreenPoint[] = [];
    for (const corner of outlineOf(grid, crosshair, axis)) {
      const seen = pixelFromLps(geometry, corner);
      if (seen !== null) corners.push(viewport.screenAt(seen));
    }
    const [first] = corners;
    if (first === undefined || corners.length < 3) continue;
    line(ink, [...corners, first], PLANE_COLOURS[name], over ? 2 : 1, over ? 1 : 0.65);
    const rightmost = corners.reduce((best, corner) => (corner.x > best.x ? corner : best), first);
    names.name(ink, name, { x: rightmost.x - 18, y: rightmost.y }, PLANE_COLOURS[name], viewport.size);
  }
}

/** Draw the angles of the C-arm as text. */
function paintAngles(ink: Ink, scene: Scene): void {
  carmText(scene.carm).forEach((words, index) => {
    label(ink, words, { x: 7, y: 13 + 15 * index }, { size: 11, align: "left" });
  });
}
