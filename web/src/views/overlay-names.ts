/** Overlay of the airway tree view: branches in the colours of their lobes, and names that do not overlap. */

import type { BranchNode } from "../state/airways";
import { pixelFromLps, type SeenGeometry } from "../state/projection";
import { asVec3 } from "../state/vec";
import { INK, type Ink, line, type NamePlaces, type ScreenPoint } from "./ink";
import type { Scene } from "./scene";
import type { Viewport } from "./viewport";

/**
 * Lobe colours, the same as in the list: oranges on the right and blues on the left, which also differ in lightness.
 * Names always accompany the colours.
 */
export const LOBE_COLOURS = {
  RUL: "#e69f00",
  RML: "#fdd49a",
  RLL: "#b06a1b",
  LUL: "#8fd0f5",
  LML: "#d5ecfb",
  LLL: "#3f7fd0",
} as const;

/** Width of the rings on hand-drawn branches, and of the gaps between these rings, CSS px. */
const RING_PX = 4;
/** Area of the view per name, CSS px squared. A small view therefore shows only the names of large branches. */
const PX2_A_NAME = 4800;

/** Draw the branches with a known lobe in the colour of the lobe. */
export function paintLobes(ink: Ink, viewport: Viewport, geometry: SeenGeometry, scene: Scene): void {
  for (const node of scene.named) {
    const band = node.lobe === null ? null : bandOf(viewport, geometry, node);
    if (band !== null && node.lobe !== null) line(ink, band.points, LOBE_COLOURS[node.lobe], band.width, 0.5);
  }
  // The renderer draws hand-drawn branches like other branches; amber rings distinguish them.
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

/**
 * Return the line and the width (CSS px) of a band that is as wide as a branch's lumen; null if the camera sees no point
 * of the branch.
 */
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
 * Draw names at the middle of their branches, large branches first, after the names of targets and stations. A bronchus
 * in several pieces is named once. A name is on the side away from the trachea, so that it does not cover the airways
 * of the other lung.
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
