/**
 * Overlay of the targets with a size, and of the needle path to the selected target, in slices, outside views and the
 * airway view.
 */

import { type FlatGeometry, type Geometry, normalOf, pixelFromLps } from "../state/projection";
import { type Surface, sectionOf } from "../state/section";
import { add, scale, sub, type Vec3 } from "../state/vec";
import { INK, type Ink, label, line, type NamePlaces, type ScreenPoint } from "./ink";
import type { Scene, SceneLesion } from "./scene";
import type { Viewport } from "./viewport";

/** Width of a target's outline, CSS px. */
const OUTLINE_PX = 1.75;
/** Width of the needle path, CSS px. */
const NEEDLE_PX = 2.5;
/** Dash pattern of the needle path, CSS px. */
const DASH: readonly number[] = [6, 3];
/** Opacity of a target's silhouette behind a wall, low enough that the wall stays visible. */
const BEHIND_ALPHA = 0.22;
/** Number of parts into which the needle path is divided for its projection. */
const PARTS = 24;
/** Distance of a target's label above the target's middle, CSS px. */
const LABEL_PX = 24;
/** Half the width of the mark of the planned tip, CSS px. */
const TIP_PX = 5;
/** Distance of the tip from the parking position, mm, up to which the airway view shows the needle path. */
const NEEDLE_FROM_MM = 25;

/** Draw each target with a size: its outline in a slice, or its silhouette in a projection. */
export function paintLesionsFlat(
  ink: Ink,
  viewport: Viewport,
  geometry: FlatGeometry,
  scene: Scene,
  seesThrough: boolean,
  inPlane: (depthMm: number) => boolean,
): void {
  for (const lesion of scene.lesions) {
    if (seesThrough) paintSilhouette(ink, viewport, geometry, lesion.surface, lesion.chosen ? 0.3 : 0.18);
    else paintSection(ink, viewport, geometry, lesion);
  }
  paintNeedle(ink, viewport, geometry, scene, inPlane);
}

/** Draw the silhouettes of the targets, and the needle path, in an outside view. */
export function paintLesionsOutside(ink: Ink, viewport: Viewport, geometry: Geometry, scene: Scene): void {
  for (const lesion of scene.lesions) {
    paintSilhouette(ink, viewport, geometry, lesion.surface, lesion.chosen ? 0.45 : 0.25);
  }
  paintNeedle(ink, viewport, geometry, scene, () => true);
}

/** Draw the targets behind the airway wall, with their distances from the lens, up to `mostMm`. */
export function paintLesionsSeen(ink: Ink, viewport: Viewport, geometry: Geometry, scene: Scene, mostMm: number): void {
  if (geometry.kind !== "seen") return;
  for (const lesion of scene.lesions) {
    const seen = pixelFromLps(geometry, lesion.centre);
    if (seen === null || seen.depthMm < 0) continue;
    const awayMm = Math.hypot(...sub(lesion.centre, geometry.camera.position));
    if (awayMm > mostMm) continue;
    paintSilhouette(ink, viewport, geometry, lesion.surface, lesion.chosen ? BEHIND_ALPHA : BEHIND_ALPHA / 2);
    const at = viewport.screenAt(seen);
    // Place the label above the target's middle, because the needle path ends at the middle.
    const beside = { x: at.x, y: at.y - LABEL_PX };
    label(ink, `${lesion.name}, ${awayMm.toFixed(0)} mm`, beside, { size: 11, colour: INK.lesion });
  }
  const toGoMm = scene.needle?.toGoMm ?? null;
  // Draw the needle path only near the parking position; from farther away a wall is between the lens and the needle
  // path.
  if (toGoMm === null || toGoMm <= NEEDLE_FROM_MM)
    paintNeedle(ink, viewport, geometry, scene, (depthMm) => depthMm < mostMm);
}

/**
 * Mark the place where the scope's tip is when the needle is advanced, in a radiograph: a diamond with a name, because
 * the scope's present tip is elsewhere until it arrives.
 */
export function paintPlannedTip(
  ink: Ink,
  viewport: Viewport,
  geometry: Geometry,
  scene: Scene,
  names: NamePlaces,
): void {
  if (scene.needle === null) return;
  const seen = pixelFromLps(geometry, scene.needle.tip);
  if (seen === null) return;
  const at = viewport.screenAt(seen);
  ink.save();
  for (const [width, colour] of [
    [3.5, INK.halo],
    [1.5, INK.needle],
  ] as const) {
    ink.lineWidth = width;
    ink.strokeStyle = colour;
    ink.beginPath();
    ink.moveTo(at.x, at.y - TIP_PX);
    ink.lineTo(at.x + TIP_PX, at.y);
    ink.lineTo(at.x, at.y + TIP_PX);
    ink.lineTo(at.x - TIP_PX, at.y);
    ink.closePath();
    ink.stroke();
  }
  ink.restore();
  names.name(ink, "Planned tip", at, INK.needle, viewport.size, [-1, 1]);
}

function paintSection(ink: Ink, viewport: Viewport, geometry: FlatGeometry, lesion: SceneLesion): void {
  const lines = sectionOf(lesion.surface, geometry.origin, normalOf(geometry));
  if (lines.length === 0) return;
  ink.save();
  ink.lineCap = "round";
  for (const [width, colour, alpha] of [
    [OUTLINE_PX + 2, INK.halo, 0.5],
    [OUTLINE_PX, INK.lesion, lesion.chosen ? 1 : 0.75],
  ] as const) {
    ink.globalAlpha = alpha;
    ink.strokeStyle = colour;
    ink.lineWidth = width;
    ink.beginPath();
    for (const [from, to] of lines) {
      const [a, b] = [pixelFromLps(geometry, from), pixelFromLps(geometry, to)];
      if (a === null || b === null) continue;
      const [start, end] = [viewport.screenAt(a), viewport.screenAt(b)];
      ink.moveTo(start.x, start.y);
      ink.lineTo(end.x, end.y);
    }
    ink.stroke();
  }
  ink.restore();
}

/**
 * Draw the convex hull of a projected target surface. A nodule is nearly convex, and its silhouette is not used for
 * measurements.
 */
function paintSilhouette(ink: Ink, viewport: Viewport, geometry: Geometry, surface: Surface, alpha: number): void {
  const points: ScreenPoint[] = [];
  for (const vertex of surface.vertices) {
    const seen = pixelFromLps(geometry, vertex);
    if (seen !== null) points.push(viewport.screenAt(seen));
  }
  const hull = hullOf(points);
  if (hull.length < 3) return;
  ink.save();
  ink.beginPath();
  for (const [n, point] of hull.entries()) {
    if (n === 0) ink.moveTo(point.x, point.y);
    else ink.lineTo(point.x, point.y);
  }
  ink.closePath();
  ink.globalAlpha = alpha;
  ink.fillStyle = INK.lesion;
  ink.fill();
  ink.globalAlpha = 0.8;
  ink.strokeStyle = INK.lesion;
  ink.lineWidth = 1.25;
  ink.stroke();
  ink.restore();
}

/** Return the convex hull of screen points (Andrew's monotone chain). */
export function hullOf(points: readonly ScreenPoint[]): ScreenPoint[] {
  const sorted = [...points].sort((a, b) => a.x - b.x || a.y - b.y);
  const half = (list: readonly ScreenPoint[]): ScreenPoint[] => {
    const hull: ScreenPoint[] = [];
    for (const point of list) {
      for (;;) {
        const [a, b] = [hull.at(-2), hull.at(-1)];
        if (a === undefined || b === undefined) break;
        if ((b.x - a.x) * (point.y - a.y) - (b.y - a.y) * (point.x - a.x) > 0) break;
        hull.pop();
      }
      hull.push(point);
    }
    return hull.slice(0, -1);
  };
  return [...half(sorted), ...half(sorted.reverse())];
}

function paintNeedle(
  ink: Ink,
  viewport: Viewport,
  geometry: Geometry,
  scene: Scene,
  inPlane: (depthMm: number) => boolean,
): void {
  const { needle } = scene;
  if (needle === null || !scene.routeLineVisible) return;
  const way = sub(needle.aim, needle.tip);
  const points = Array.from({ length: PARTS + 1 }, (_, n): Vec3 => add(needle.tip, scale(way, n / PARTS)));
  const seen = points.map((point) => pixelFromLps(geometry, point));
  ink.save();
  ink.setLineDash([...DASH]);
  let run: ScreenPoint[] = [];
  let near = true;
  const draw = () => {
    line(ink, run, INK.halo, NEEDLE_PX + 2, near ? 0.6 : 0.25);
    line(ink, run, INK.needle, NEEDLE_PX, near ? 1 : 0.45);
  };
  for (const point of seen) {
    if (point === null) {
      draw();
      run = [];
      continue;
    }
    const at = viewport.screenAt(point);
    const isNear = inPlane(point.depthMm);
    run.push(at);
    if (isNear !== near) {
      draw();
      run = [at];
      near = isNear;
    }
  }
  draw();
  ink.restore();
}
