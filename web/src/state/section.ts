/** Where a surface of triangles cuts a plane, and which parts of a route a lens sees. */

import { add, dot, scale, sub, type Vec3 } from "./vec";

export interface Surface {
  readonly vertices: readonly Vec3[];
  /** Three places in the vertices each. */
  readonly triangles: readonly number[];
}

/** The lines in which a surface cuts the plane through `origin` with the unit `normal`. */
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
      // A corner in the plane counts as above it: each crossing is found once.
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

/** Between two places that are looked at whether the view to them is free, mm. */
const LOOK_MM = 1.5;
/** So much beyond the wall still counts as free: a centreline is not the middle of what is seen. */
const SLACK_MM = 0.75;

/**
 * How many of a line's points a lens sees before a wall hides the rest. The line is the middle of a tube: a point is in
 * view where the straight way to it stays in the tube.
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
  // Before the line begins there is the lens's own stretch of lumen.
  if (first !== undefined && Math.hypot(...sub(at, first)) <= (radiiMm[0] ?? 0) + NEAR_LENS_MM) return true;
  for (let n = 0; n <= upTo; n += 1) {
    const point = points[n];
    if (point !== undefined && Math.hypot(...sub(at, point)) <= (radiiMm[n] ?? 0) + SLACK_MM) return true;
  }
  return false;
}

const NEAR_LENS_MM = 6;
