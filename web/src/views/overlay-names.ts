/** The tree from outside in the colours of its lobes, with names that never print over one another. */

import type { BranchNode } from "../state/airways";
import { pixelFromLps, type SeenGeometry } from "../state/projection";
import { asVec3 } from "../state/vec";
import { INK, type Ink, line, NamePlaces } from "./ink";
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

/** A name needs so much of the picture, CSS px squared: a small cell shows the large branches' names only. */
const PX2_A_NAME = 4800;

export function paintLobes(ink: Ink, viewport: Viewport, geometry: SeenGeometry, scene: Scene): void {
  for (const node of scene.named) {
    if (node.lobe === null) continue;
    const { points, radius } = node.branch;
    const seen = points.flatMap((point) => pixelFromLps(geometry, asVec3(point)) ?? []);
    const depth = seen[seen.length >> 1]?.depthMm;
    if (depth === undefined) continue;
    const mean = radius.reduce((sum, mm) => sum + mm, 0) / Math.max(radius.length, 1);
    const width = ((2 * mean * geometry.focalPx) / depth) * viewport.magnification;
    line(
      ink,
      seen.map((pixel) => viewport.screenAt(pixel)),
      LOBE_COLOURS[node.lobe],
      Math.max(width, 1.5),
      0.5,
    );
  }
}

/** Names at the middle of their branches, large branches first. */
export function paintNames(ink: Ink, viewport: Viewport, geometry: SeenGeometry, scene: Scene): void {
  const { width, height } = viewport.size;
  const places = new NamePlaces();
  let left = Math.floor((width * height) / PX2_A_NAME);
  for (const node of scene.titled) {
    if (left <= 0) return;
    const middle = middleOf(node);
    const seen = middle === null ? null : pixelFromLps(geometry, middle);
    if (seen === null) continue;
    if (places.name(ink, node.label, viewport.screenAt(seen), INK.text, viewport.size)) left -= 1;
  }
}

function middleOf(node: BranchNode) {
  const point = node.branch.points[node.branch.points.length >> 1];
  return point === undefined ? null : asVec3(point);
}
