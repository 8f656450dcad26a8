/** Cached bounding spheres of the branch centrelines, which quickly exclude branches that are far from a plane. */

import type { BranchNode } from "./airways";
import { add, asVec3, distance, scale, type Vec3 } from "./vec";

/** A sphere: centre (LPS) and radius in mm. */
export interface Sphere {
  readonly centre: Vec3;
  readonly radiusMm: number;
}

const known = new WeakMap<BranchNode, Sphere>();

/** Return the bounding sphere of a branch; null for a branch without points. */
export function sphereOf(node: BranchNode): Sphere | null {
  const found = known.get(node);
  if (found !== undefined) return found;
  const points = node.branch.points.map((point) => asVec3(point));
  const [first, last] = [points[0], points.at(-1)];
  if (first === undefined || last === undefined) return null;
  const centre = scale(add(first, last), 0.5);
  const sphere = { centre, radiusMm: Math.max(...points.map((point) => distance(point, centre))) };
  known.set(node, sphere);
  return sphere;
}
