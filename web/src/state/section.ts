/** Intersection of a triangle surface with a plane, and visibility of a route from the lens. */

import { add, dot, scale, sub, type Vec3 } from "./vec";

/** A surface of triangles: vertices (LPS mm) and vertex indices. */
export interface Surface {
  readonly vertices: readonly Vec3[];
  /** Indices of the vertices, three per triangle. */
  readonly triangles: readonly number[];
}

/** Return the line pieces in which a surface intersects the plane through `origin` with the unit vector `normal`. */
export function sectionOf(surface: Surface, origin: Vec3, normal: Vec3): [Vec3, Vec3][] {
  const height = surface.vertices.map((vertex) => dot(sub(vertex, origin), normal));
  const lines: [Vec3, Vec3][] = [];
  for (let n = 0; n + 2 < surface.triangles.length; n += 3) {
    const corners = [surface.triangles[n] ?? 0, surface.triangles[n + 1] ?? 0, surface.triangles[n + 2] ?? 0] as const;
    const ends: Vec3[] = [];
    for (const [from, to] of [
      [corners[0], corners[1]],
      [corners[1], corners[2]],
      [corners[2], corners[0]],
    ] as const) {
      const [a, b] = [height[from] ?? 0, height[to] ?? 0];
      // A vertex in the plane counts as above the plane, so that each crossing is found once.
      if (a >= 0 === b >= 0) continue;
      const [start, end] = [surface.vertices[from], surface.vertices[to]];
      if (start === undefined || end === undefined) continue;
      ends.push(add(start, scale(sub(end, start), a / (a - b))));
    }
    const [first, second] = ends;
    if (first !== undefined && second !== undefined) lines.push([first, second]);
  }
  return lines;
}

/** Step in mm of the test along the line of sight whether a point is visible. */
const LOOK_MM = 1.5;
/**
 * Distance beyond the lumen's radius, mm, at which a point of the line of sight still counts as inside, because the
 * centreline is not exactly in the middle of the lumen.
 */
const SLACK_MM = 0.75;

/**
 * Return the number of leading centreline points that the lens sees before a wall hides the following ones. A point is
 * visible if the straight line to it stays inside the tube of the given radii.
 */
export function numInView(lens: Vec3, points: readonly Vec3[], radiiMm: readonly number[]): number {
  for (let n = 0; n < points.length; n += 1) {
    const point = points[n];
    if (point === undefined) return n;
    const way = sub(point, lens);
    const awayMm = Math.hypot(...way);
    const steps = Math.ceil(awayMm / LOOK_MM);
    for (let k = 1; k < steps; k += 1) {
      const at = add(lens, scale(way, k / steps));
      if (!isInTube(at, points, radiiMm, n)) return n;
    }
  }
  return points.length;
}

function isInTube(at: Vec3, points: readonly Vec3[], radiiMm: readonly number[], upTo: number): boolean {
  const first = points[0];
  // The lumen between the lens and the first point also counts as inside the tube.
  if (first !== undefined && Math.hypot(...sub(at, first)) <= (radiiMm[0] ?? 0) + NEAR_LENS_MM) return true;
  for (let n = 0; n <= upTo; n += 1) {
    const point = points[n];
    if (point !== undefined && Math.hypot(...sub(at, point)) <= (radiiMm[n] ?? 0) + SLACK_MM) return true;
  }
  return false;
}

const NEAR_LENS_MM = 6;
