/** Overlay at the cursor: the path to the cursor, the edit preview, the brush, and the text at the cursor. */

import { type Geometry, projectLine } from "../state/projection";
import type { Vec3 } from "../state/vec";
import { FONT, INK, type Ink, line, type ScreenPoint } from "./ink";
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
/** Largest width of a line of the text at the cursor, CSS px; about 36 characters. */
const MAX_LINE_PX = 220;
/** Space beside the text: its padding, and 2 px to each edge of the view, CSS px. */
const MARGINS_PX = 16;

/** Draw the text at the cursor in the view under the cursor; nothing in other views. */
export function paintCursorNote(ink: Ink, viewport: Viewport, scene: Scene): void {
  const { cursor } = scene;
  if (cursor === null || cursor.view !== viewport.view) return;
  // Read the text only in the view under the cursor, so that the other views are not repainted when the text changes.
  const { note } = scene;
  if (note === null) return;
  ink.save();
  ink.font = `12px ${FONT}`;
  // A view can be narrower than the widest line.
  const widest = Math.min(MAX_LINE_PX, viewport.size.width - MARGINS_PX);
  const lines = note.lines.flatMap((words) => wrapped(words, (text) => ink.measureText(text).width <= widest));
  if (lines.length === 0) {
    ink.restore();
    return;
  }
  const width = Math.max(...lines.map((words) => ink.measureText(words).width)) + 12;
  const height = lines.length * LINE_PX + 7;
  const { width: right, height: bottom } = viewport.size;
  // Place the text beside the cursor on the side with enough space, and never under the cursor.
  const x = cursor.x + 16 + width <= right ? cursor.x + 16 : Math.max(cursor.x - 16 - width, 2);
  const y = Math.min(Math.max(cursor.y + 12 + height <= bottom ? cursor.y + 12 : cursor.y - 12 - height, 2), bottom);
  ink.fillStyle = "rgba(8, 10, 12, 0.82)";
  ink.beginPath();
  ink.roundRect(x, y, width, height, 4);
  ink.fill();
  ink.fillStyle = note.warns ? INK.warning : INK.text;
  ink.textAlign = "left";
  ink.textBaseline = "middle";
  for (const [n, words] of lines.entries()) ink.fillText(words, x + 6, y + 4 + LINE_PX * (n + 0.5));
  ink.restore();
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
