import { describe, expect, it } from "vitest";
import { randomAxes, randomOf } from "./rotations.testing";
import { add, distance, scale, type Vec3 } from "./vec";
import { clampToVolume, type Grid, isInterpolated, sliceOf } from "./volume";

/** Return an oblique, anisotropic grid, on which swapped axes fail the test. */
function obliqueGrid(random: () => number) {
  const { right, down, forward } = randomAxes(random);
  const [a, b, c] = [scale(right, 0.6), scale(down, 0.8), scale(forward, 2.5)];
  const origin: Vec3 = [-120, 35, 400];
  const grid: Grid = {
    shape_zyx: [7, 20, 31],
    lps_from_ijk: [
      ...[a[0], b[0], c[0], origin[0]],
      ...[a[1], b[1], c[1], origin[1]],
      ...[a[2], b[2], c[2], origin[2]],
      ...[0, 0, 0, 1],
    ],
  };
  const at = (i: number, j: number, k: number): Vec3 => add(origin, add(add(scale(a, i), scale(b, j)), scale(c, k)));
  return { grid, at };
}

describe("clampToVolume", () => {
  it("A point inside the volume is returned unchanged.", () => {
    const random = randomOf(21);
    for (let round = 0; round < 100; round += 1) {
      const { grid, at } = obliqueGrid(random);
      const point = at(30.9 * random() - 0.4, 19.8 * random() - 0.4, 6.8 * random() - 0.4);
      expect(clampToVolume(grid, point)).toBe(point);
    }
  });

  it("A point outside is moved to the nearest voxel coordinate inside, on each axis separately.", () => {
    const random = randomOf(22);
    for (let round = 0; round < 100; round += 1) {
      const { grid, at } = obliqueGrid(random);
      // Tolerance 1e-6 mm: rounding of coordinates of some hundred mm.
      expect(distance(clampToVolume(grid, at(50, 3, 2)), at(30.499, 3, 2))).toBeLessThan(1e-6);
      expect(distance(clampToVolume(grid, at(4, -9, 2)), at(4, -0.499, 2))).toBeLessThan(1e-6);
      expect(distance(clampToVolume(grid, at(4, 3, 70)), at(4, 3, 6.499))).toBeLessThan(1e-6);
    }
  });
});

describe("sliceOf", () => {
  it("A plane parallel to the slices has the index of its slice, and another plane has none.", () => {
    const { grid, at } = obliqueGrid(randomOf(3));
    const [right, down, ahead] = [1, 2, 3].map((axis) =>
      add(at(axis === 1 ? 1 : 0, axis === 2 ? 1 : 0, axis === 3 ? 1 : 0), scale(at(0, 0, 0), -1)),
    ) as [Vec3, Vec3, Vec3];
    expect(sliceOf(grid, at(11, 4, 3.25), right, down)).toBeCloseTo(3.25, 9);
    expect(sliceOf(grid, at(11, 4, 3), add(right, down), down)).toBeCloseTo(3, 9);
    expect(sliceOf(grid, at(11, 4, 3), right, ahead)).toBeNull();
  });
  it("A plane up to the neighbouring measured slices shows interpolated values.", () => {
    expect([2, 2.5, 3, 3.5, 4].map((slice) => isInterpolated(slice, [3]))).toEqual([false, true, true, true, false]);
    expect(isInterpolated(null, [3])).toBe(false);
    expect(isInterpolated(3, [])).toBe(false);
  });
});
