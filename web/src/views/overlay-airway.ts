/**
 * Overlay of the airway view: orientation ring, path to the cursor, and route line. All are computed from the displayed
 * picture.
 */

import { angleBetween, type RingMark, ringMarks } from "../state/letters";
import { distanceToRouteMm, turnBefore } from "../state/plan";
import { geometryOf, projectLine, type SeenGeometry } from "../state/projection";
import { pointsBetween, radiusAt } from "../state/route";
import { nextTurn } from "../state/route-dots";
import { numInView } from "../state/section";
import { asVec3, distance, type Vec3 } from "../state/vec";
import type { RouteInfo } from "../wire/messages";
import { INK, type Ink, label, line, type ScreenPoint } from "./ink";
import { traceOutline } from "./outline";
import { paintCursorNote, paintLivePath, paintPreview } from "./overlay-cursor";
import { paintGhost } from "./overlay-ghost";
import { paintLesionsSeen } from "./overlay-lesion";
import { paintPen } from "./overlay-pen";
import { paintDrawn, paintTreeAhead } from "./overlay-tree";
import type { Scene } from "./scene";
import { RING_PX, type Viewport } from "./viewport";
import { paintWallMarks } from "./wall-marks";

/** Distance ahead of the tip, mm, at which the route line begins, because nearer parts would cover the tip. */
const LINE_FROM_MM = 6;
/** Distance ahead of the tip, mm, at which the route line ends, because farther parts would show through walls. */
const LINE_TO_MM = 45;
/** Distance from the lens, mm, up to which a target behind the wall is shown. */
const TARGET_TO_MM = 80;
/** Step along the route of the test whether the lens sees the route, mm. */
const LOOK_APART_MM = 1;
/** Number of ticks on the clock dial. */
const HOURS = 12;
/** Space around a letter of the ring without the lines of the dial, px. */
const LETTER_PX = 16;

/** Draw the overlay of the airway view. */
export function paintAirway(ink: Ink, viewport: Viewport, scene: Scene): void {
  const { header, frame } = viewport;
  const centre = { x: frame.x + frame.width / 2, y: frame.y + frame.height / 2 };
  const round = scene.airwayShape !== "fill";
  const radius = Math.min(frame.width, frame.height) / 2 + (round ? RING_PX / 2 : -RING_PX / 2);
  if (radius < 20) return;
  const geometry = header === null ? null : geometryOf(header);
  if (geometry === null || geometry.kind !== "seen") {
    if (round) paintDial(ink, centre, radius, []);
    return;
  }

  ink.save();
  traceOutline(ink, scene.airwayShape, frame);
  ink.clip();
  const runs = routeLine(scene, geometry.camera.position);
  if (runs.length > 0) {
    ink.save();
    ink.setLineDash([1, 7]);
    for (const run of runs.flatMap((part) => projectLine(geometry, part))) {
      const points = run.map((point) => viewport.screenAt(point));
      line(ink, points, INK.halo, 4.5, 0.5);
      line(ink, points, INK.accent, 3, 0.95);
    }
    ink.restore();
  }
  paintLesionsSeen(ink, viewport, geometry, scene, TARGET_TO_MM);
  paintDrawn(ink, viewport, geometry, aheadOf(geometry, scene), () => true);
  paintTreeAhead(ink, viewport, geometry, scene);
  paintLivePath(ink, viewport, geometry, withinReach(geometry, scene), () => true);
  paintPreview(ink, viewport, geometry, previewInView(geometry, scene), () => true);
  paintWallMarks(ink, viewport, geometry, scene);
  paintGhost(ink, viewport, geometry, scene);
  paintPen(ink, viewport, geometry, scene, (depthMm) => depthMm < LINE_TO_MM);
  ink.restore();
  const marks = ringMarks(geometry.camera);
  if (round) paintDial(ink, centre, radius, marks);
  for (const mark of marks) {
    const at = { x: centre.x + radius * Math.sin(mark.angleRad), y: centre.y - radius * Math.cos(mark.angleRad) };
    label(ink, mark.text, at, { size: mark.strength > 0.8 ? 15 : 12, bold: true });
  }
  paintCursorNote(ink, viewport, scene);
}

/**
 * Return the visible runs of the route ahead of the lens. At a listed turn, the line ends with the dots of the turn,
 * which are inside the outlined opening: points of the route beyond the fork can be behind a wall.
 */
export function routeLine(scene: Scene, lens: Vec3): Vec3[][] {
  const { route, turns } = scene;
  if (!scene.routeLineVisible || route === null) return [];
  const fromMm = scene.pathMm ?? (turnBefore(turns, lens) === null ? null : distanceToRouteMm(route, lens));
  if (fromMm === null) return [];
  const turn = nextTurn(route, turns, fromMm);
  const seenToMm = inViewTo(route, fromMm, lens);
  const endMm = Math.min(seenToMm, turn?.forkMm ?? seenToMm);
  // Only the tracked parts of the route; `paintDrawn` draws the other parts dashed, as branches.
  const ahead = route.spans
    .filter((span) => span.kind === "tracked")
    .map((span) => [Math.max(span.from_mm, fromMm + LINE_FROM_MM), Math.min(span.to_mm, endMm)] as const)
    .filter(([from, to]) => to > from)
    .map(([from, to]) => pointsBetween(route, from, to));
  if (turn !== null && turn.forkMm <= seenToMm) {
    const dots = turn.dots.filter((dot) => distance(dot, lens) < LINE_TO_MM);
    if (dots.length > 0) ahead.push([...(ahead.pop() ?? pointsBetween(route, turn.forkMm, turn.forkMm)), ...dots]);
  }
  return ahead;
}

/** Return the position along the route, mm, up to which the lens sees the route before a wall hides the route. */
function inViewTo(route: RouteInfo, fromMm: number, lens: Vec3): number {
  const places: number[] = [];
  for (let mm = fromMm + LINE_FROM_MM; mm <= Math.min(fromMm + LINE_TO_MM, route.length_mm); mm += LOOK_APART_MM)
    places.push(mm);
  const points = places.flatMap((mm) => pointsBetween(route, mm, mm).slice(0, 1));
  const radii = places.map((mm) => radiusAt(route, mm));
  const count = route.lumen_known ? numInView(lens, points, radii) : places.length;
  return count === places.length ? fromMm + LINE_TO_MM : (places[count] ?? fromMm);
}

/** Return the scene with only those hand-drawn branches that are near enough to the lens; walls hide the others. */
function aheadOf(geometry: SeenGeometry, scene: Scene): Scene {
  if (scene.drawn.length === 0) return scene;
  const near = scene.drawn.filter(({ branch }) =>
    branch.points.some((point) => distance(asVec3(point), geometry.camera.position) < LINE_TO_MM),
  );
  return { ...scene, drawn: near };
}

/** Return the scene with only those runs of the edit preview that are near enough to the lens. */
function previewInView(geometry: SeenGeometry, scene: Scene): Scene {
  if (scene.preview === null) return scene;
  const runs = scene.preview.runs.filter(({ points }) =>
    points.some((point) => distance(point, geometry.camera.position) < LINE_TO_MM),
  );
  return { ...scene, preview: { ...scene.preview, runs } };
}

/**
 * Return the scene with the path to the cursor from the path point nearest to the lens on. The part before that point
 * is not ahead of the lens.
 */
function withinReach(geometry: SeenGeometry, scene: Scene): Scene {
  const { live } = scene;
  if (live === null) return scene;
  const away = live.points.map((point) => distance(point, geometry.camera.position));
  const first = away.indexOf(Math.min(...away));
  return { ...scene, live: { points: live.points.slice(first), leavesAt: Math.max(live.leavesAt - first, 0) } };
}

/** Draw the clock dial around the picture. A letter of the ring replaces the tick of its hour. */
function paintDial(ink: Ink, centre: ScreenPoint, radius: number, marks: readonly RingMark[]): void {
  ink.save();
  ink.strokeStyle = INK.ring;
  ink.lineWidth = 1;
  ink.beginPath();
  ink.arc(centre.x, centre.y, radius + RING_PX / 2 - 1, 0, 2 * Math.PI);
  ink.stroke();
  ink.restore();
  for (let hour = 0; hour < HOURS; hour += 1) {
    const angle = (hour / HOURS) * 2 * Math.PI;
    if (marks.some((mark) => angleBetween(mark.angleRad, angle) * radius < LETTER_PX)) continue;
    const from = radius + RING_PX / 2 - 1;
    const to = from - (hour % 3 === 0 ? 6 : 4);
    line(
      ink,
      [from, to].map((r) => ({ x: centre.x + r * Math.sin(angle), y: centre.y - r * Math.cos(angle) })),
      INK.ringTick,
      hour === 0 ? 2 : 1,
    );
  }
}
