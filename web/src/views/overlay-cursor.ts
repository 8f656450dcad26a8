/** Overlay at the cursor: the path to the cursor, the edit preview, the brush, and the text at the cursor. */

import { type Geometry, projectLine } from "../state/projection";
import type { Vec3 } from "../state/vec";
import { FONT, INK, type Ink, line, type Rect, type ScreenPoint } from "./ink";
import type { Scene } from "./scene";
import type { Viewport } from "./viewport";

/**
 * Draw the path to the cursor: white inside the tree, and in the accent colour beyond the tree; parts off a slice are
 * faint.
 */
export function paintLivePath(
  ink: Ink,
  viewport: Viewport,
  geometry: Geometry,
  scene: Scene,
  inPlane: (depthMm: number) => boolean,
): void {
  const { live } = scene;
  if (live === null || live.points.length < 2) return;
  const parts = [
    { points: live.points.slice(0, live.leavesAt + 1), colour: INK.text },
    { points: live.points.slice(live.leavesAt), colour: INK.accent },
  ];
  for (const { points, colour } of parts) strokeWay(ink, viewport, geometry, points, inPlane, { colour });
}

/**
 * Draw the preview of an edit: a solid line where the CT shows an airway, and a dashed amber line where the branch
 * would be drawn by hand.
 */
export function paintPreview(
  ink: Ink,
  viewport: Viewport,
  geometry: Geometry,
  scene: Scene,
  inPlane: (depthMm: number) => boolean,
): void {
  if (scene.preview === null) return;
  const { runs, faint } = scene.preview;
  for (const { points, drawn } of runs) {
    const colour = drawn ? INK.warning : INK.accent;
    strokeWay(ink, viewport, geometry, points, inPlane, { colour, dashed: drawn, alpha: faint ? 0.35 : 1 });
  }
}

/** Draw a line of patient points over a picture; parts off a slice are thin. */
function strokeWay(
  ink: Ink,
  viewport: Viewport,
  geometry: Geometry,
  way: readonly Vec3[],
  inPlane: (depthMm: number) => boolean,
  { colour, dashed = false, alpha = 1 }: { colour: string; dashed?: boolean; alpha?: number },
): void {
  const stroke = (points: readonly ScreenPoint[], width: number, opacity = alpha) => {
    ink.save();
    if (dashed) ink.setLineDash([5, 5]);
    line(ink, points, colour, width, opacity);
    ink.restore();
  };
  for (const run of projectLine(geometry, way)) {
    const all = run.map((point) => viewport.screenAt(point));
    if (geometry.kind === "seen") {
      line(ink, all, INK.halo, 5, 0.7 * alpha);
      stroke(all, 2.5);
      continue;
    }
    line(ink, all, INK.halo, 3, 0.4 * alpha);
    stroke(all, 1.25, 0.55 * alpha);
    let near: ScreenPoint[] = [];
    for (const [n, point] of run.entries()) {
      const at = all[n];
      if (at !== undefined && inPlane(point.depthMm)) near.push(at);
      else {
        stroke(near, 2.5);
        near = [];
      }
    }
    stroke(near, 2.5);
  }
}

/** Draw the brush in its true size, and the stroke in progress. `mmPerPx` is the size of a screen pixel, mm. */
export function paintBrush(
  ink: Ink,
  viewport: Viewport,
  scene: Scene,
  mmPerPx: number,
  toScreen: (lps: Scene["stroke"][number]) => ScreenPoint | null,
): void {
  const { brush, cursor } = scene;
  if (brush === null || !(mmPerPx > 0)) return;
  const colour = brush.erase ? INK.warning : INK.accent;
  const radius = brush.radiusMm / mmPerPx;
  if (cursor?.view === viewport.view) {
    const drawn = scene.stroke.flatMap((lps) => toScreen(lps) ?? []);
    line(ink, drawn, colour, 2 * radius, 0.35);
    ink.save();
    for (const [width, stroke] of [
      [3, INK.halo],
      [1.5, colour],
    ] as const) {
      ink.lineWidth = width;
      ink.strokeStyle = stroke;
      ink.beginPath();
      ink.arc(cursor.x, cursor.y, Math.max(radius, 1.5), 0, 2 * Math.PI);
      ink.stroke();
    }
    ink.restore();
  }
}

/** Height of a line of the text at the cursor, CSS px. */
const LINE_PX = 15;
/** Maximum width of a line of the text at the cursor, CSS px; about 36 characters. */
const MAX_LINE_PX = 220;
/** Space beside the text: its padding, and 2 px to each edge of the view, CSS px. */
const MARGINS_PX = 16;

/** Distance of the text from the cursor, CSS px. */
const BESIDE_PX = { x: 16, y: 12 };
/** Minimum distance of the text from the edges of the view and from elements over the picture, CSS px. */
const APART_PX = 2;

/** Draw the text at the cursor in the view under the cursor; nothing in other views. */
export function paintCursorNote(ink: Ink, viewport: Viewport, scene: Scene): void {
  const { cursor } = scene;
  if (cursor === null || cursor.view !== viewport.view) return;
  // Read the text only in the view under the cursor, so that the other views are not repainted when the text changes.
  const { note } = scene;
  if (note === null || note.lines.length === 0) return;
  ink.save();
  ink.font = `12px ${FONT}`;
  const { size } = viewport;
  // A view can be narrower than the widest line.
  const widest = Math.min(MAX_LINE_PX, size.width - MARGINS_PX);
  const { lines, box } = placedNote(note.lines, cursor, size, viewport.coveredParts(), {
    fits: (text) => ink.measureText(text).width <= widest,
    sizeOf: (lines) => ({
      width: Math.max(...lines.map((words) => ink.measureText(words).width)) + 12,
      height: lines.length * LINE_PX + 7,
    }),
  });
  ink.fillStyle = "rgba(8, 10, 12, 0.82)";
  ink.beginPath();
  ink.roundRect(box.x, box.y, box.width, box.height, 4);
  ink.fill();
  ink.fillStyle = note.warns ? INK.warning : INK.text;
  ink.textAlign = "left";
  ink.textBaseline = "middle";
  for (const [n, words] of lines.entries()) ink.fillText(words, box.x + 6, box.y + 4 + LINE_PX * (n + 0.5));
  ink.restore();
}

/** Size of a rectangle, CSS px. */
type Size = Pick<Rect, "width" | "height">;

/**
 * Return the lines of the text at the cursor and their place. If the view has no space for all lines, the last ones are
 * left out. `fits` states whether a line fits the width, `sizeOf` the size of lines with their margins.
 */
export function placedNote(
  texts: readonly string[],
  cursor: ScreenPoint,
  view: Size,
  covered: readonly Rect[],
  { fits, sizeOf }: { fits: (line: string) => boolean; sizeOf: (lines: readonly string[]) => Size },
): { lines: readonly string[]; box: Rect } {
  for (let shown = texts.length; ; shown -= 1) {
    const rest = shown < texts.length ? ["and more"] : [];
    const lines = [...texts.slice(0, shown), ...rest].flatMap((words) => wrapped(words, fits));
    const size = sizeOf(lines);
    const box = notePlace(cursor, size, view, covered);
    if (box !== null) return { lines, box };
    if (shown <= 1) return { lines, box: { ...size, x: APART_PX, y: APART_PX } };
  }
}

/**
 * Return a place for the text beside the cursor that no element over the picture covers; null if there is none. The text
 * covers the point at the cursor only if there is no other place.
 */
export function notePlace(cursor: ScreenPoint, size: Size, view: Size, covered: readonly Rect[]): Rect | null {
  const right = view.width - size.width - APART_PX;
  const xs = [
    cursor.x + BESIDE_PX.x,
    cursor.x - BESIDE_PX.x - size.width,
    Math.min(Math.max(cursor.x - size.width / 2, APART_PX), right),
  ];
  const ys = [
    cursor.y + BESIDE_PX.y,
    cursor.y - BESIDE_PX.y - size.height,
    APART_PX,
    view.height - size.height - APART_PX,
    ...covered.flatMap((one) => [one.y + one.height + APART_PX, one.y - size.height - APART_PX]),
  ];
  const inside = xs
    .flatMap((x) => ys.map((y) => ({ x, y, ...size })))
    .filter((box) => box.x >= APART_PX && box.x <= right)
    .filter((box) => box.y >= APART_PX && box.y <= view.height - size.height - APART_PX);
  const free = inside.filter((box) => covered.every((one) => !overlap(box, one)));
  const atCursor = { x: cursor.x - 4, y: cursor.y - 4, width: 8, height: 8 };
  return free.find((box) => !overlap(box, atCursor)) ?? free[0] ?? null;
}

/** Return whether two rectangles overlap. */
function overlap(one: Rect, other: Rect): boolean {
  return (
    one.x < other.x + other.width &&
    other.x < one.x + one.width &&
    one.y < other.y + other.height &&
    other.y < one.y + one.height
  );
}

/** Break a text between words into lines that fit; a word that does not fit alone has its own line. */
export function wrapped(words: string, fits: (line: string) => boolean): string[] {
  const lines: string[] = [];
  for (const word of words.split(" ")) {
    const last = lines.at(-1);
    if (last !== undefined && fits(`${last} ${word}`)) lines[lines.length - 1] = `${last} ${word}`;
    else lines.push(word);
  }
  return lines;
}
