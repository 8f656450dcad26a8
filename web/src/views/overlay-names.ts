/** The tree from outside in the colours of its lobes, with names that never print over one another. */

import type { BranchNode } from "../state/airways";
import { pixelFromLps, type SeenGeometry } from "../state/projection";
import { asVec3 } from "../state/vec";
import { INK, type Ink, line, type NamePlaces, type ScreenPoint } from "./ink";
import type { Scene } from "./scene";
import type { Viewport } from "./viewport";

/** Right in oranges, left in blues, told apart by lightness too (as in the list). A colour never stands without names. */
export const LOBE_COLOURS = {
  RUL: "#e69f00",
  RML: "#fdd49a",
  RLL: "#b06a1b",
  LUL: "#8fd0f5",
  LML: "#d5ecfb",
  LLL: "#3f7fd0",
} as const;

/** Of the rings across what a person drew, and of the gaps between them, CSS px. */
const RING_PX = 4;
/** A name needs so much of the picture, CSS px squared: a small cell shows the large branches' names only. */
const PX2_A_NAME = 4800;

export function paintLobes(ink: Ink, viewport: Viewport, geometry: SeenGeometry, scene: Scene): void {
  for (const node of scene.named) {
    const band = node.lobe === null ? null : bandOf(viewport, geometry, node);
    if (band !== null && node.lobe !== null) line(ink, band.points, LOBE_COLOURS[node.lobe], band.width, 0.5);
  }
  // The tube of what a person drew is cast like any other: amber rings across it say that it is none.
  for (const node of scene.drawn) {
    const band = bandOf(viewport, geometry, node);
    if (band === null) continue;
    ink.save();
    ink.setLineDash([RING_PX, RING_PX]);
    ink.lineCap = "butt";
    ink.lineJoin = "bevel";
    ink.globalAlpha = 0.75;
    ink.strokeStyle = INK.warning;
    ink.lineWidth = 1.15 * band.width;
    ink.beginPath();
    band.points.forEach((point, n) => {
      if (n === 0) ink.moveTo(point.x, point.y);
      else ink.lineTo(point.x, point.y);
    });
    ink.stroke();
    ink.restore();
  }
}

/** A branch as a band as wide as its lumen. */
function bandOf(
  viewport: Viewport,
  geometry: SeenGeometry,
  node: BranchNode,
): { points: ScreenPoint[]; width: number } | null {
  const { points, radius } = node.branch;
  const seen = points.flatMap((point) => pixelFromLps(geometry, asVec3(point)) ?? []);
  const depth = seen[seen.length >> 1]?.depthMm;
  if (depth === undefined) return null;
  const mean = radius.reduce((sum, mm) => sum + mm, 0) / Math.max(radius.length, 1);
  const width = ((2 * mean * geometry.focalPx) / depth) * viewport.magnification;
  return { points: seen.map((pixel) => viewport.screenAt(pixel)), width: Math.max(width, 1.5) };
}

/**
 * Names at the middle of their branches, large branches first; those of targets and stations are there before. A bronchus
 * in several pieces is named once. Names stand on the side away from the trachea: across the tree they would name the
 * airways of the other lung.
 */
export function paintNames(
  ink: Ink,
  viewport: Viewport,
  geometry: SeenGeometry,
  scene: Scene,
  places: NamePlaces,
): void {
  const { width, height } = viewport.size;
  const trachea = scene.trunkEnd === null ? null : pixelFromLps(geometry, scene.trunkEnd);
  const trunkX = trachea === null ? width / 2 : viewport.screenAt(trachea).x;
  let left = Math.floor((width * height) / PX2_A_NAME);
  const done = new Set<string>();
  for (const node of scene.titled) {
    if (left <= 0) return;
    const middle = middleOf(node);
    const seen = middle === null ? null : pixelFromLps(geometry, middle);
    if (seen === null || done.has(node.label)) continue;
    const at = viewport.screenAt(seen);
    if (!places.name(ink, node.label, at, INK.text, viewport.size, [at.x < trunkX ? -1 : 1])) continue;
    done.add(node.label);
    left -= 1;
  }
}

function middleOf(node: BranchNode) {
  const point = node.branch.points[node.branch.points.length >> 1];
  return point === undefined ? null : asVec3(point);
}
