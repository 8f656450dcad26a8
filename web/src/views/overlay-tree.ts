/**
 * Overlay of the airway tree on pictures: branches drawn by hand, places that the search could not follow, and the
 * hovered or selected branch.
 */

import type { BranchNode } from "../state/airways";
import { kindText } from "../state/branch-text";
import { type Geometry, pixelFromLps, projectLine, type SeenPoint } from "../state/projection";
import { openingOf } from "../state/tree-index";
import { asVec3, type Vec3 } from "../state/vec";
import { LEAD_VIEW } from "../wire/views";
import { INK, type Ink, label, line, NamePlaces, type ScreenPoint } from "./ink";
import type { Scene } from "./scene";
import type { Viewport } from "./viewport";

const DASH: readonly number[] = [5, 4];
/** Opacity of parts that are off the slice. */
const FAINT = 0.3;
/** Width of a planar view, CSS px, from which hand-drawn branches are labelled. */
const NAMED_FROM_PX = 300;

/**
 * Draw the uncertain places, the hovered branch and the selected branch on slices, X-rays and outside views. `inPlane`
 * returns whether a point at a depth belongs to the slice.
 */
export function paintTree(
  ink: Ink,
  viewport: Viewport,
  geometry: Geometry,
  scene: Scene,
  inPlane: (depthMm: number) => boolean,
): void {
  const names = new NamePlaces();
  for (const place of scene.uncertain) paintUncertain(ink, viewport, geometry, asVec3(place.lps), inPlane);
  // Draw all branches of the selected bronchus, which the list shows as one row.
  for (const piece of scene.selected?.row ?? []) {
    if (piece !== scene.hovered?.node) paintNode(ink, viewport, geometry, piece, inPlane);
  }
  if (scene.hovered !== null) {
    const { node } = scene.hovered;
    // If the lumen outline is visible, a slice already shows the lumen, so its band is not drawn.
    const cut = geometry.kind === "flat" && !inPlane(Number.MAX_VALUE);
    if (!(cut && scene.outlineVisible)) paintLumen(ink, viewport, geometry, node, inPlane);
    paintNode(ink, viewport, geometry, node, inPlane);
    const middle = node.branch.points[node.branch.points.length >> 1];
    const seen = middle === undefined ? null : pixelFromLps(geometry, asVec3(middle));
    // In the view under the cursor, the text at the cursor contains the branch's name.
    if (seen !== null && scene.cursor?.view !== viewport.view && (geometry.kind === "seen" || inPlane(seen.depthMm))) {
      names.name(ink, node.label, viewport.screenAt(seen), INK.text, viewport.size);
    }
  }
}

/** Draw the lines and the fork that the active tool would change: amber, above the route. */
export function paintActedOn(
  ink: Ink,
  viewport: Viewport,
  geometry: Geometry,
  scene: Scene,
  inPlane: (depthMm: number) => boolean,
): void {
  for (const points of scene.doomed) {
    for (const run of runsOf(viewport, geometry, points, inPlane)) {
      line(ink, run, INK.halo, 5, 0.6);
      line(ink, run, INK.warning, 3);
    }
  }
  if (scene.heldFork !== null) paintFork(ink, viewport, geometry, scene.heldFork, inPlane);
}

/** Draw bridges and branches drawn by hand above everything else: amber, dashed and labelled. */
export function paintDrawn(
  ink: Ink,
  viewport: Viewport,
  geometry: Geometry,
  scene: Scene,
  inPlane: (depthMm: number) => boolean,
): void {
  const names = new NamePlaces();
  for (const node of scene.drawn) paintDrawnBranch(ink, viewport, geometry, node, inPlane, names);
}

/** Draw a ring at the opening of the hovered branch in the airway view. */
export function paintTreeAhead(ink: Ink, viewport: Viewport, geometry: Geometry, scene: Scene): void {
  if (geometry.kind !== "seen") return;
  const node = scene.hovered?.node ?? null;
  if (node === null || node.branch.id === scene.hereId) return;
  const opening = openingOf(node, geometry);
  if (opening === null) return;
  const at = viewport.screenAt(opening);
  const radius = Math.max(opening.radiusPx * viewport.magnification, 6);
  for (const [width, colour] of [
    [4, INK.halo],
    [1.75, INK.text],
  ] as const) {
    ink.save();
    ink.lineWidth = width;
    ink.strokeStyle = colour;
    ink.beginPath();
    ink.arc(at.x, at.y, radius, 0, 2 * Math.PI);
    ink.stroke();
    ink.restore();
  }
  if (scene.cursor?.view !== LEAD_VIEW) label(ink, node.label, { x: at.x, y: at.y - radius - 9 }, { size: 12 });
}

/** Return the centreline points of a branch, LPS mm. */
export const pointsOf = (node: BranchNode): Vec3[] => node.branch.points.map((point) => asVec3(point));

/** Return the runs of a line that belong to the picture, in screen coordinates. */
function runsOf(
  viewport: Viewport,
  geometry: Geometry,
  points: readonly Vec3[],
  inPlane: (depthMm: number) => boolean,
): ScreenPoint[][] {
  const runs: ScreenPoint[][] = [];
  for (const run of projectLine(geometry, points)) {
    let part: ScreenPoint[] = [];
    for (const point of run) {
      if (geometry.kind === "seen" || inPlane(point.depthMm)) part.push(viewport.screenAt(point));
      else {
        if (part.length > 1) runs.push(part);
        part = [];
      }
    }
    if (part.length > 1) runs.push(part);
  }
  return runs;
}

/** Draw the centreline of a branch. Branches drawn by hand are in `drawn` and never a solid line. */
function paintNode(
  ink: Ink,
  viewport: Viewport,
  geometry: Geometry,
  node: BranchNode,
  inPlane: (depthMm: number) => boolean,
): void {
  if (node.branch.kind === "tracked") paintCentreline(ink, viewport, geometry, pointsOf(node), INK.text, inPlane);
}

function paintCentreline(
  ink: Ink,
  viewport: Viewport,
  geometry: Geometry,
  points: readonly Vec3[],
  colour: string,
  inPlane: (depthMm: number) => boolean,
): void {
  if (geometry.kind === "flat") {
    // Draw the parts that are off the slice faintly.
    for (const run of projectLine(geometry, points)) {
      line(
        ink,
        run.map((point) => viewport.screenAt(point)),
        colour,
        1,
        FAINT,
      );
    }
  }
  for (const run of runsOf(viewport, geometry, points, inPlane)) {
    line(ink, run, INK.halo, 4, 0.6);
    line(ink, run, colour, 2);
  }
}

/** Draw the lumen of a branch: a band as wide as the lumen in outside views, cross-sections in a slice. */
function paintLumen(
  ink: Ink,
  viewport: Viewport,
  geometry: Geometry,
  node: BranchNode,
  inPlane: (depthMm: number) => boolean,
): void {
  const { points, radius } = node.branch;
  ink.save();
  ink.fillStyle = INK.accent;
  ink.strokeStyle = INK.accent;
  ink.globalAlpha = 0.38;
  ink.beginPath();
  points.forEach((point, n) => {
    const seen = pixelFromLps(geometry, asVec3(point));
    if (seen === null) return;
    const reach = chordPx(viewport, geometry, seen, radius[n] ?? 0, inPlane);
    if (reach <= 0.5) return;
    const at = viewport.screenAt(seen);
    ink.moveTo(at.x + reach, at.y);
    ink.arc(at.x, at.y, reach, 0, 2 * Math.PI);
  });
  ink.fill("nonzero");
  ink.restore();
}

/** Return half the width of a branch's lumen in the picture, CSS px; 0 if the slice does not cut the lumen. */
function chordPx(
  viewport: Viewport,
  geometry: Geometry,
  seen: SeenPoint,
  radiusMm: number,
  inPlane: (depthMm: number) => boolean,
): number {
  if (geometry.kind === "seen") return ((radiusMm * geometry.focalPx) / seen.depthMm) * viewport.magnification;
  const perMm = viewport.magnification / Math.hypot(...geometry.perColumn);
  if (Math.abs(seen.depthMm) < radiusMm) return Math.sqrt(radiusMm ** 2 - seen.depthMm ** 2) * perMm;
  // A projection such as an X-ray shows the whole lumen.
  return inPlane(Number.MAX_VALUE) ? radiusMm * perMm : 0;
}

function paintDrawnBranch(
  ink: Ink,
  viewport: Viewport,
  geometry: Geometry,
  node: BranchNode,
  inPlane: (depthMm: number) => boolean,
  names: NamePlaces,
): void {
  const runs = runsOf(viewport, geometry, pointsOf(node), inPlane);
  if (runs.length === 0) return;
  ink.save();
  ink.setLineDash([...DASH]);
  for (const run of runs) {
    line(ink, run, INK.halo, 5, 0.6);
    line(ink, run, INK.warning, 2.5);
  }
  ink.restore();
  const longest = runs.reduce<ScreenPoint[]>((best, run) => (run.length > best.length ? run : best), []);
  const middle = longest[longest.length >> 1];
  // In a small slice the label would cover the branch that it names.
  const hasRoom = geometry.kind === "seen" || viewport.size.width >= NAMED_FROM_PX;
  if (middle !== undefined && hasRoom)
    names.name(ink, kindText(node.branch.kind) ?? "", middle, INK.warning, viewport.size);
}

/**
 * Draw an uncertain place: a small amber ring with a gap, because the direction in which the airway continues is
 * unknown.
 */
function paintUncertain(
  ink: Ink,
  viewport: Viewport,
  geometry: Geometry,
  lps: Vec3,
  inPlane: (depthMm: number) => boolean,
): void {
  const seen = pixelFromLps(geometry, lps);
  if (seen === null || (geometry.kind === "flat" && !inPlane(seen.depthMm))) return;
  const at = viewport.screenAt(seen);
  ink.save();
  for (const [width, colour] of [
    [3, INK.halo],
    [1.5, INK.warning],
  ] as const) {
    ink.lineWidth = width;
    ink.strokeStyle = colour;
    ink.setLineDash([3, 2]);
    ink.beginPath();
    ink.arc(at.x, at.y, 3.5, 0, 2 * Math.PI);
    ink.stroke();
  }
  ink.restore();
}

function paintFork(
  ink: Ink,
  viewport: Viewport,
  geometry: Geometry,
  lps: Vec3,
  inPlane: (depthMm: number) => boolean,
): void {
  const seen = pixelFromLps(geometry, lps);
  if (seen === null) return;
  const at = viewport.screenAt(seen);
  ink.save();
  ink.globalAlpha = geometry.kind === "seen" || inPlane(seen.depthMm) ? 1 : FAINT;
  ink.fillStyle = INK.warning;
  ink.strokeStyle = INK.halo;
  ink.lineWidth = 3;
  ink.beginPath();
  ink.arc(at.x, at.y, 5, 0, 2 * Math.PI);
  ink.stroke();
  ink.fill();
  ink.restore();
}
