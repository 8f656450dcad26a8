/** Random rotations for property tests. */

import { cross, type Vec3 } from "./vec";

/** Return a small random generator with a fixed seed, so that a failing test can be repeated. */
export function randomOf(seed: number): () => number {
  let state = seed;
  return () => {
    state = (state * 1664525 + 1013904223) % 2 ** 32;
    return state / 2 ** 32;
  };
}

/** Return the columns of a random rotation, computed from a random unit quaternion. */
export function randomAxes(random: () => number): { right: Vec3; down: Vec3; forward: Vec3 } {
  const [u, v, w] = [random(), 2 * Math.PI * random(), 2 * Math.PI * random()];
  const [x, y, z, q] = [
    Math.sqrt(1 - u) * Math.sin(v),
    Math.sqrt(1 - u) * Math.cos(v),
    Math.sqrt(u) * Math.sin(w),
    Math.sqrt(u) * Math.cos(w),
  ];
  const right: Vec3 = [1 - 2 * (y * y + z * z), 2 * (x * y + z * q), 2 * (x * z - y * q)];
  const down: Vec3 = [2 * (x * y - z * q), 1 - 2 * (x * x + z * z), 2 * (y * z + x * q)];
  return { right, down, forward: cross(right, down) };
}
