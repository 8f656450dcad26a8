/** Which branch lies under a cursor: in a slice, from outside, and in the airway view. All from the tree's centrelines. */

import type { BranchNode, BranchTree, TreeIndex } from "./branch-tree";
import { type Geometry, type PixelPoint, pixelFromLps, type SeenGeometry } from "./projection";
import { add, type Camera, distance, dot, scale, sub, unit, type Vec3 } from "./vec";

export type { TreeIndex } from "./branch-tree";

/** A place on the tree. */
export interface TreePlace {
  readonly branchId: number;
  /** Along the branch, from its beginning. */
  readonly alongMm: number;
  /** On the centreline. */
  readonly lps: Vec3;
  readonly radiusMm: number;
  /** From the point that was asked about to the centreline. */
  readonly distanceMm: number;
}

export function indexOf(nodes: Iterable<BranchNode>): TreeIndex {
  const all = [...nodes];
  const count = all.reduce((sum, node) => sum + node.branch.points.length, 0);
  const index: TreeIndex = {
    x: new Float64Array(count),
    y: new Float64Array(count),
    z: new Float64Array(count),
    radius: new Float64Array(count),
    along: new Float64Array(count),
    branch: new Int32Array(count),
  };
  let at = 0;
  for (const { branch } of all) {
    let along = 0;
    branch.points.forEach((point, n) => {
      const before = branch.points[n - 1];
      if (before !== undefined) {
        along += Math.hypot(point[0] - before[0], point[1] - before[1], point[2] - before[2]);
      }
      index.x[at] = point[0];
      index.y[at] = point[1];
      index.z[at] = point[2];
      index.radius[at] = branch.radius[n] ?? 0;
      index.along[at] = along;
      index.branch[at] = branch.id;
      at += 1;
    });
  }
  return index;
}

function placeOf(index: TreeIndex, n: number, distanceMm: number): TreePlace {
  return {
    branchId: index.branch[n] ?? 0,
    alongMm: index.along[n] ?? 0,
    lps: [index.x[n] ?? 0, index.y[n] ?? 0, index.z[n] ?? 0],
    radiusMm: index.radius[n] ?? 0,
    distanceMm,
  };
}

/** The nearest place of the centrelines; null where there are none. At a fork the thinner, later branch wins. */
export function nearestPlace(index: TreeIndex, lps: Vec3): TreePlace | null {
  let best = -1;
  let least = Number.POSITIVE_INFINITY;
  for (let n = 0; n < index.x.length; n += 1) {
    const dx = (index.x[n] ?? 0) - lps[0];
    const dy = (index.y[n] ?? 0) - lps[1];
    const dz = (index.z[n] ?? 0) - lps[2];
    const squared = dx * dx + dy * dy + dz * dz;
    if (squared < least) {
      least = squared;
      best = n;
    }
  }
  return best < 0 ? null : placeOf(index, best, Math.sqrt(least));
}

/** Beyond the stated radius a place still counts as in the lumen: half a voxel of a usual CT, and centrelines are not exact. */
const IN_LUMEN = { times: 1.15, plusMm: 0.6 };

/** The branch whose lumen a point lies in, or null. */
export function placeInLumen(index: TreeIndex, lps: Vec3): TreePlace | null {
  // Not the nearest centreline: near a thick airway's wall a thin one's may be nearer and yet not reach so far.
  let best = -1;
  let least = 1;
  for (let n = 0; n < index.x.length; n += 1) {
    const reach = (index.radius[n] ?? 0) * IN_LUMEN.times + IN_LUMEN.plusMm;
    const dx = (index.x[n] ?? 0) - lps[0];
    if (dx > reach || dx < -reach) continue;
    const dy = (index.y[n] ?? 0) - lps[1];
    const dz = (index.z[n] ?? 0) - lps[2];
    const part = (dx * dx + dy * dy + dz * dz) / (reach * reach);
    if (part < least) {
      least = part;
      best = n;
    }
  }
  if (best < 0) return null;
  const place = placeOf(index, best, 0);
  return { ...place, distanceMm: distance(place.lps, lps) };
}

/** A thin branch can still be pointed at from this far, screen px. */
const REACH_PX = 7;

/** The place of the tree under a cursor that sees it from outside: of all lumens under it the one in front. */
export function placeFromOutside(
  index: TreeIndex,
  geometry: SeenGeometry,
  pixel: PixelPoint,
  pxPerScreenPx: number,
): TreePlace | null {
  const { camera, focalPx, width, height } = geometry;
  let best = -1;
  let bestWorth = Number.POSITIVE_INFINITY;
  for (let n = 0; n < index.x.length; n += 1) {
    const offset: Vec3 = [
      (index.x[n] ?? 0) - camera.position[0],
      (index.y[n] ?? 0) - camera.position[1],
      (index.z[n] ?? 0) - camera.position[2],
    ];
    const depth = dot(offset, camera.forward);
    if (depth < 1) continue;
    const perMm = focalPx / depth;
    const away = Math.hypot(
      width / 2 + perMm * dot(offset, camera.right) - pixel.column,
      height / 2 + perMm * dot(offset, camera.down) - pixel.row,
    );
    const radius = index.radius[n] ?? 0;
    if (away > radius * perMm + REACH_PX * pxPerScreenPx) continue;
    // In front first; beside one another the nearer to the cursor. A lumen's near wall hides what lies in and behind it.
    const worth = depth - radius + (2 * away) / perMm;
    if (worth < bestWorth) {
      bestWorth = worth;
      best = n;
    }
  }
  if (best < 0) return null;
  return placeOf(index, best, 0);
}

/** How far ahead an opening can be told from the wall around it. */
const AHEAD_MM = 90;
const GENERATIONS_AHEAD = 3;

/**
 * The branch that a place in the airway picture leads into, as far as the openings ahead tell: of those under the cursor
 * the farthest one in, else the branch that the tip is in.
 */
export function branchAhead(tree: BranchTree, hereId: number, geometry: Geometry, pixel: PixelPoint): number | null {
  const here = tree.byId.get(hereId);
  if (here === undefined || geometry.kind !== "seen") return null;
  let best = hereId;
  const visit = (node: BranchNode, left: number): void => {
    for (const child of node.children) {
      const opening = openingOf(child, geometry);
      if (opening === null) continue;
      if (Math.hypot(opening.column - pixel.column, opening.row - pixel.row) > opening.radiusPx) continue;
      best = child.branch.id;
      if (left > 1) visit(child, left - 1);
    }
  };
  visit(here, GENERATIONS_AHEAD);
  return best;
}

export interface Opening extends PixelPoint {
  readonly radiusPx: number;
}

/** Where a branch's beginning shows in a picture from a camera, and how large; null where it is not ahead. */
export function openingOf(node: BranchNode, geometry: SeenGeometry): Opening | null {
  const { branch } = node;
  // Past the spur: where the branch is its own.
  const far = Math.min(Math.max(node.diameterMm, 3), 8);
  let along = 0;
  let at = 0;
  for (let n = 1; n < branch.points.length && along < far; n += 1) {
    along += distance(pointOf(branch.points[n - 1]), pointOf(branch.points[n]));
    at = n;
  }
  const lps = pointOf(branch.points[at]);
  const seen = pixelFromLps(geometry, lps);
  if (seen === null || seen.depthMm < 1 || seen.depthMm > AHEAD_MM) return null;
  // One radius aside, as the lens sees it: exact for any lens, not only a pinhole.
  const aside = pixelFromLps(geometry, add(lps, scale(sideways(geometry.camera), branch.radius[at] ?? 1)));
  if (aside === null) return null;
  return {
    column: seen.column,
    row: seen.row,
    radiusPx: Math.hypot(aside.column - seen.column, aside.row - seen.row),
  };
}

const sideways = (camera: Camera): Vec3 => unit(camera.right);

const pointOf = (point: readonly [number, number, number] | undefined): Vec3 => point ?? [0, 0, 0];

/** Points of a branch from a place along it to its end, that place included. */
export function pointsFrom(node: BranchNode, alongMm: number): Vec3[] {
  const { points } = node.branch;
  let along = 0;
  for (let n = 1; n < points.length; n += 1) {
    const a = pointOf(points[n - 1]);
    const b = pointOf(points[n]);
    const step = distance(a, b);
    if (along + step >= alongMm) {
      const part = step > 0 ? Math.max(alongMm - along, 0) / step : 0;
      return [add(a, scale(sub(b, a), part)), ...points.slice(n).map(pointOf)];
    }
    along += step;
  }
  return points.slice(-1).map(pointOf);
}

/** All that hangs on a branch, itself first. */
export function below(node: BranchNode): BranchNode[] {
  const found = [node];
  for (let n = 0; n < found.length; n += 1) {
    for (const child of found[n]?.children ?? []) if (!found.includes(child)) found.push(child);
  }
  return found;
}
