/** Overlay of the curved pictures along the route: distance axis, names, lumen, targets, tip, letters and scale bar. */

import { kindText } from "../state/branch-text";
import { fixed } from "../state/format";
import { axesAt, type LinesGeometry, linesOf, nearestPixel, pixelOfPath } from "../state/lines";
import { multiplesBetween, pastMm, pathAtMm, radiusAt } from "../state/route";
import type { RouteInfo } from "../wire/messages";
import { VIEWS } from "../wire/views";
import { INK, type Ink, label, line, NamePlaces, penMark, type ScreenPoint, targetMark, tipMark } from "./ink";
import { paintCursorNote } from "./overlay-cursor";
import { paintLetters, paintScale, paintSlab } from "./overlay-flat";
import type { Scene } from "./scene";
import type { Viewport } from "./viewport";

/** Distance of an object from the surface of the picture, mm, up to which the object counts as in the surface. */
const IN_SURFACE_MM = 2.5;
/** Distance of a target from the surface of the picture, mm, beyond which the target is not drawn. */
const NEAR_SURFACE_MM = 15;
/** Half the width of the straightened airway's strip, mm, as the server renders the strip. */
const STRIP_MM = 40;
/** Minimum distance of the distance axis from the left edge, CSS px. */
const AXIS_PX = 7;
/** Space beside a strip for the distance axis, CSS px. */
const AXIS_ROOM_PX = 66;
/** Space beside a strip for the names of the branches, CSS px. */
const NAMES_ROOM_PX = 110;
/** Length of a tick of the axis with the distances along the route, CSS px. */
const TICK_PX = 4;
/** Minimum distance between two ticks of the distance axis, CSS px. */
const TICKS_APART_PX = 30;
/** Minimum vertical distance between two names of branches, CSS px. */
const NAMES_APART_PX = 15;
const DASH: readonly number[] = [5, 4];
const TICKS_MM = [1, 2, 5, 10, 20, 50, 100, 200] as const;

/** Draw the overlay of a curved picture. */
export function paintLines(ink: Ink, viewport: Viewport, scene: Scene): void {
  const { header } = viewport;
  const geometry = header === null ? null : linesOf(header.lines);
  if (header === null || geometry === null) return;
  const sides = sidesOf(viewport, geometry, VIEWS[header.view].straight);
  const names = new NamePlaces();
  if (scene.route !== null) {
    if (VIEWS[header.view].straight && scene.route.lumen_known) paintLumen(ink, viewport, geometry, scene.route);
    else if (scene.routeLineVisible) paintPath(ink, viewport, geometry, scene.route);
    paintAxis(ink, viewport, geometry, scene.route, sides);
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
  if (scene.pen !== null) {
    const seen = nearestPixel(geometry, scene.pen.lps);
    if (seen.awayMm <= NEAR_SURFACE_MM) penMark(ink, viewport.screenAt(seen), seen.awayMm <= IN_SURFACE_MM);
  }
  paintLetters(ink, viewport, axesAt(geometry), sides);
  paintScale(ink, viewport, geometry.mmPerPx);
  paintSlab(ink, viewport, scene);
  paintCursorNote(ink, viewport, scene);
}

/**
 * Return the horizontal positions of the distance axis and of the names, CSS px: at the sides of the picture, or beside
 * the strip if there is space.
 */
function sidesOf(viewport: Viewport, geometry: LinesGeometry, isStrip: boolean): { left: number; right: number } {
  const { width } = viewport.size;
  if (!isStrip) return { left: AXIS_PX, right: width - 8 };
  const middle = viewport.screenAt({ column: geometry.pathColumn[0] ?? 0, row: 0 }).x;
  const half = (STRIP_MM / geometry.mmPerPx) * viewport.magnification;
  return {
    left: Math.max(middle - half - AXIS_ROOM_PX, AXIS_PX),
    right: Math.min(middle + half + NAMES_ROOM_PX, width - 8),
  };
}

/** Return the rows of the picture between start and end of the route, both included. */
function rowsOnPath(geometry: LinesGeometry): number[] {
  const first = pixelOfPath(geometry, geometry.pathMm[0] ?? 0)?.row ?? 0;
  const last = pixelOfPath(geometry, geometry.pathMm.at(-1) ?? 0)?.row ?? 0;
  return geometry.rows
    .map((_, index) => index)
    .filter((index) => {
      const row = geometry.rows[index] ?? 0;
      return row >= first && row <= last;
    });
}

/** Draw the measured width of the lumen as two lines. */
function paintLumen(ink: Ink, viewport: Viewport, geometry: LinesGeometry, route: RouteInfo): void {
  // Leave out the parts that were drawn by hand, because they have no measured lumen.
  const seen = partsOnPath(geometry, route).filter((part) => !part.drawn);
  for (const [side, rows] of [-1, 1].flatMap((side) => seen.map((part) => [side, part.rows] as const))) {
    const points: ScreenPoint[] = [];
    for (const index of rows) {
      const row = geometry.rows[index] ?? 0;
      const column = geometry.pathColumn[index] ?? 0;
      const radiusPx = radiusAt(route, geometry.pathMm[index] ?? 0) / geometry.mmPerPx;
      points.push(viewport.screenAt({ column: column + side * radiusPx, row }));
    }
    ink.save();
    ink.setLineDash([2, 3]);
    line(ink, points, INK.accent, 1, 0.7);
    ink.restore();
  }
}

function paintPath(ink: Ink, viewport: Viewport, geometry: LinesGeometry, route: RouteInfo): void {
  for (const { rows, drawn } of partsOnPath(geometry, route)) {
    const points = rows.map((index) =>
      viewport.screenAt({ column: geometry.pathColumn[index] ?? 0, row: geometry.rows[index] ?? 0 }),
    );
    ink.save();
    if (drawn) ink.setLineDash([...DASH]);
    line(ink, points, drawn ? INK.warning : INK.accent, 1.5, drawn ? 0.9 : 0.6);
    ink.restore();
  }
}

/**
 * Split the rows that show the route into runs that the CT shows and runs drawn by hand; neighbouring runs share a row.
 */
function partsOnPath(geometry: LinesGeometry, route: RouteInfo): { rows: number[]; drawn: boolean }[] {
  const parts: { rows: number[]; drawn: boolean }[] = [];
  for (const index of rowsOnPath(geometry)) {
    const mm = geometry.pathMm[index] ?? 0;
    const drawn = route.spans.some((span) => span.kind !== "tracked" && mm > span.from_mm && mm <= span.to_mm);
    const last = parts.at(-1);
    if (last?.drawn === drawn) last.rows.push(index);
    else {
      last?.rows.push(index);
      parts.push({ rows: [index], drawn });
    }
  }
  return parts;
}

function paintAxis(
  ink: Ink,
  viewport: Viewport,
  geometry: LinesGeometry,
  route: RouteInfo,
  sides: { left: number; right: number },
): void {
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
      { x: sides.left, y: top },
      { x: sides.left, y: bottom },
    ],
    INK.accent,
    1.5,
    0.9,
  );
  for (const span of route.spans.filter((one) => one.kind !== "tracked")) {
    const [from, to] = [yOf(Math.max(span.from_mm, first)), yOf(Math.min(span.to_mm, last))];
    if (from === null || to === null || to <= from) continue;
    const ends = [from, to].map((y) => ({ x: sides.left, y }));
    line(ink, ends, INK.halo, 3);
    ink.save();
    ink.setLineDash([...DASH]);
    line(ink, ends, INK.warning, 2);
    ink.restore();
  }
  const pxPerMm = (bottom - top) / Math.max(last - first, 1e-6);
  const stepMm = TICKS_MM.find((mm) => mm * pxPerMm >= TICKS_APART_PX) ?? 500;
  const { height } = viewport.size;
  const ticks = multiplesBetween(pastMm(route, first), pastMm(route, last), stepMm);
  for (const past of ticks) {
    const y = yOf(pathAtMm(route, past));
    if (y === null || y < 8 || y > height - 34) continue;
    line(
      ink,
      [
        { x: sides.left, y },
        { x: sides.left + TICK_PX, y },
      ],
      INK.accent,
      1.5,
    );
    label(ink, `${fixed(past)} mm`, { x: sides.left + TICK_PX + 4, y }, { size: 10, align: "left" });
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
          { x: sides.right - TICK_PX, y: a },
          { x: sides.right, y: a },
        ],
        INK.quiet,
        1.5,
      );
    }
    const y = (Math.max(a, 0) + Math.min(b, height)) / 2;
    if (y - taken < NAMES_APART_PX || y < 26 || y > height - 26) continue;
    const kind = kindText(span.kind);
    if (!route.lumen_known && kind === null) continue;
    label(
      ink,
      kind ?? span.name ?? `gen. ${span.generation}`,
      { x: sides.right - TICK_PX - 4, y },
      { size: 11, align: "right", colour: kind === null ? INK.text : INK.warning },
    );
    taken = y;
  }
}
