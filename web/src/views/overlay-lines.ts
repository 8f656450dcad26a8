/** Over the pictures along the route: distances and names on the axis, the lumen, targets, tip, letters, scale. */

import { fixed } from "../state/format";
import { axesAt, type LinesGeometry, linesOf, nearestPixel, pixelOfPath } from "../state/lines";
import { radiusAt } from "../state/route";
import type { RouteInfo } from "../wire/messages";
import { INK, type Ink, label, line, NamePlaces, type ScreenPoint, targetMark, tipMark } from "./ink";
import { paintLetters, paintScale, paintSlab } from "./overlay-flat";
import type { Scene } from "./scene";
import type { Viewport } from "./viewport";

/** Within this distance something counts as lying in the picture's surface. */
const IN_SURFACE_MM = 2.5;
/** Farther than this from the surface a target is not drawn at all. */
const NEAR_SURFACE_MM = 15;
const AXIS_X = 7;
const TICK_PX = 4;
const TICKS_APART_PX = 30;
const NAMES_APART_PX = 15;
const TICKS_MM = [1, 2, 5, 10, 20, 50, 100, 200] as const;

export function paintLines(ink: Ink, viewport: Viewport, scene: Scene): void {
  const { header } = viewport;
  const geometry = header === null ? null : linesOf(header.lines);
  if (header === null || geometry === null) return;
  const names = new NamePlaces();
  if (scene.route !== null) {
    if (header.view === "straightened") paintLumen(ink, viewport, geometry, scene.route);
    else if (scene.routeLineVisible) paintPath(ink, viewport, geometry);
    paintAxis(ink, viewport, geometry, scene.route);
  }
  for (const target of scene.targets) {
    const seen = nearestPixel(geometry, target.lps);
    if (seen.awayMm > NEAR_SURFACE_MM) continue;
    const at = viewport.screenAt(seen);
    const near = seen.awayMm <= IN_SURFACE_MM;
    const colour = target.reachable ? INK.accent : INK.warning;
    targetMark(ink, at, colour, near ? 1 : 0.35);
    if (near) names.name(ink, target.name, at, colour, viewport.size);
  }
  if (scene.tip !== null) {
    const onPath = scene.pathMm === null ? null : pixelOfPath(geometry, scene.pathMm);
    const seen = onPath === null ? nearestPixel(geometry, scene.tip.position) : { ...onPath, awayMm: 0 };
    const visible = seen.row >= 0 && seen.row <= header.height;
    if (visible) tipMark(ink, viewport.screenAt(seen), null, seen.awayMm <= IN_SURFACE_MM);
  }
  paintLetters(ink, viewport, axesAt(geometry), true);
  paintScale(ink, viewport, geometry.mmPerPx);
  paintSlab(ink, viewport, scene);
}

/** The lumen's width as measured, beside what the picture shows of it. */
function paintLumen(ink: Ink, viewport: Viewport, geometry: LinesGeometry, route: RouteInfo): void {
  for (const side of [-1, 1]) {
    const points: ScreenPoint[] = [];
    geometry.rows.forEach((row, index) => {
      const column = geometry.pathColumn[index] ?? 0;
      const radiusPx = radiusAt(route, geometry.pathMm[index] ?? 0) / geometry.mmPerPx;
      points.push(viewport.screenAt({ column: column + side * radiusPx, row }));
    });
    ink.save();
    ink.setLineDash([2, 3]);
    line(ink, points, INK.accent, 1, 0.7);
    ink.restore();
  }
}

function paintPath(ink: Ink, viewport: Viewport, geometry: LinesGeometry): void {
  const points = geometry.rows.map((row, index) => viewport.screenAt({ column: geometry.pathColumn[index] ?? 0, row }));
  line(ink, points, INK.accent, 1.5, 0.6);
}

function paintAxis(ink: Ink, viewport: Viewport, geometry: LinesGeometry, route: RouteInfo): void {
  const first = geometry.pathMm[0] ?? 0;
  const last = geometry.pathMm.at(-1) ?? 0;
  const yOf = (mm: number): number | null => {
    const pixel = pixelOfPath(geometry, mm);
    return pixel === null ? null : viewport.screenAt(pixel).y;
  };
  const [top, bottom] = [yOf(first), yOf(last)];
  if (top === null || bottom === null) return;
  line(
    ink,
    [
      { x: AXIS_X, y: top },
      { x: AXIS_X, y: bottom },
    ],
    INK.accent,
    1.5,
    0.9,
  );
  const pxPerMm = (bottom - top) / Math.max(last - first, 1e-6);
  const stepMm = TICKS_MM.find((mm) => mm * pxPerMm >= TICKS_APART_PX) ?? 500;
  const { width, height } = viewport.size;
  for (let mm = Math.ceil(first / stepMm - 1e-6) * stepMm; mm <= last + 1e-6; mm += stepMm) {
    const y = yOf(mm);
    if (y === null || y < 8 || y > height - 26) continue;
    line(
      ink,
      [
        { x: AXIS_X, y },
        { x: AXIS_X + TICK_PX, y },
      ],
      INK.accent,
      1.5,
    );
    label(ink, `${fixed(mm)} mm`, { x: AXIS_X + TICK_PX + 4, y }, { size: 10, align: "left" });
  }
  let taken = Number.NEGATIVE_INFINITY;
  for (const span of route.spans) {
    const from = Math.max(span.from_mm, first);
    const to = Math.min(span.to_mm, last);
    if (to <= from) continue;
    const [a, b] = [yOf(from), yOf(to)];
    if (a === null || b === null) continue;
    if (span.from_mm > first) {
      line(
        ink,
        [
          { x: width - 6 - TICK_PX, y: a },
          { x: width - 6, y: a },
        ],
        INK.quiet,
        1.5,
      );
    }
    const y = (Math.max(a, 0) + Math.min(b, height)) / 2;
    if (y - taken < NAMES_APART_PX || y < 26 || y > height - 26) continue;
    label(ink, span.name ?? `gen. ${span.generation}`, { x: width - 8, y }, { size: 11, align: "right" });
    taken = y;
  }
}
