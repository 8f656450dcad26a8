/**
 * Search of the branch under the cursor in slices, outside views and the airway view, by the centrelines of the tree.
 */

import type { BranchNode, BranchTree, TreeIndex } from "./branch-tree";
import { type Geometry, type PixelPoint, pixelFromLps, type SeenGeometry } from "./projection";
import { add, type Camera, distance, dot, scale, sub, unit, type Vec3 } from "./vec";

export type { TreeIndex } from "./branch-tree";

/** A position on the tree: a branch, and the nearest point of its centreline. */
export interface TreePlace {
  readonly branchId: number;
  /** Distance in mm from the beginning of the branch to the found point, along the branch. */
  readonly alongMm: number;
  /** Point on the centreline, LPS mm. */
  readonly lps: Vec3;
  readonly radiusMm: number;
  /** Distance in mm from the searched point to the nearest centreline. */
  readonly distanceMm: number;
}

/** Return the search index of the centreline points of all branches. */
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

/**
 * Return the position on the centrelines nearest to a patient point; null for an empty tree. At a fork, where several
 * branches are equally near, the thinner child branch is returned.
 */
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

/**
 * Tolerance of the lumen test: factor (`times`) and addend (`plusMm`) of the radius, for half a voxel of a common CT
 * and the error of the centrelines.
 */
const IN_LUMEN = { times: 1.15, plusMm: 0.6 };

/** Return the position on the branch whose lumen contains a patient point; null outside all lumens. */
export function placeInLumen(index: TreeIndex, lps: Vec3): TreePlace | null {
  // The nearest centreline is not sufficient: near the wall of a thick airway, the centreline of a thin airway may be
  // nearer although its lumen does not contain the point.
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

/** Distance from the cursor, screen px, up to which a thin branch is selected. */
const REACH_PX = 7;

/** Return the position on the frontmost branch under the cursor in an outside view; null on the background. */
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
    // Prefer the frontmost branch, because the near wall of a lumen hides everything behind it. Among branches at the
    // same depth, prefer the one nearest to the cursor.
    const worth = depth - radius + (2 * away) / perMm;
    if (worth < bestWorth) {
      bestWorth = worth;
      best = n;
    }
  }
  if (best < 0) return null;
  return placeOf(index, best, 0);
}

/** Distance ahead of the camera, mm, up to which an opening is distinguishable from the wall. */
const AHEAD_MM = 90;
/** Number of generations beyond the tip's branch whose openings are searched. */
const GENERATIONS_AHEAD = 3;

/**
 * Return the ID of the branch whose opening is under the cursor in the airway view, the farthest if there are several;
 * else the ID of the branch that contains the tip. Null if that branch does not exist.
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

/** Opening of a branch in a picture: position and radius. */
export interface Opening extends PixelPoint {
  readonly radiusPx: number;
}

/**
 * Return the position and the radius of a branch's opening in a camera picture; null if the opening is not in front of
 * the camera.
 */
export function openingOf(node: BranchNode, geometry: SeenGeometry): Opening | null {
  const { branch } = node;
  // Measure at a point past the spur, where the branch is separate from its parent.
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
  // Project a point one radius to the side, which gives the radius in the picture for every lens model and not only for
  // a pinhole.
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

/**
 * Return the centreline points of a branch from a position along it to its end. The first point is interpolated at the
 * position.
 */
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

/** Return a branch and all its descendants, the branch first. */
export function below(node: BranchNode): BranchNode[] {
  const found = [node];
  for (let n = 0; n < found.length; n += 1) {
    for (const child of found[n]?.children ?? []) if (!found.includes(child)) found.push(child);
  }
  return found;
}
