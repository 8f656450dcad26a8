import { readFileSync } from "node:fs";
import { fileURLToPath } from "node:url";
import { describe, expect, it } from "vitest";
import { geometryOf, lpsFromPixel, mmPerPixel, type Placed, pixelFromLps, projectLine, scaleBar } from "./projection";
import { randomAxes, randomOf } from "./rotations.testing";
import { add, distance, scale, type Vec3 } from "./vec";

function flat(right: Vec3, down: Vec3, origin: Vec3, perColumn: number, perRow: number) {
  const c = scale(right, perColumn);
  const r = scale(down, perRow);
  return [c[0], r[0], 0, origin[0], c[1], r[1], 0, origin[1], c[2], r[2], 0, origin[2], 0, 0, 0, 1];
}

const none = { lps_from_camera: null, fov_deg: null, lens: null, lps_from_pixel: null, width: 200, height: 100 };

describe("planar pictures", () => {
  it("pixelFromLps inverts lpsFromPixel for oblique pictures with non-square pixels.", () => {
    const random = randomOf(11);
    for (let round = 0; round < 300; round += 1) {
      const { right, down } = randomAxes(random);
      const origin: Vec3 = [100 * random() - 50, 100 * random(), -400 * random()];
      const geometry = geometryOf({ ...none, lps_from_pixel: flat(right, down, origin, 0.7, 1.3) });
      if (geometry?.kind !== "flat") throw new Error("a matrix gives a flat picture");
      const pixel = { column: 200 * random(), row: 100 * random() };
      const back = pixelFromLps(geometry, lpsFromPixel(geometry, pixel));
      // Tolerance 1e-9: double precision for coordinates of some hundred mm.
      expect(back?.column).toBeCloseTo(pixel.column, 9);
      expect(back?.row).toBeCloseTo(pixel.row, 9);
      expect(back?.depthMm).toBeCloseTo(0, 9);
    }
  });

  it("The depth is positive into the screen, in mm.", () => {
    const geometry = geometryOf({ ...none, lps_from_pixel: flat([1, 0, 0], [0, 1, 0], [0, 0, 5], 0.5, 0.5) });
    if (geometry === null) throw new Error("a matrix gives a geometry");
    // Axial picture with the patient's right at the left and anterior up: the normal into the screen points to the
    // head.
    expect(pixelFromLps(geometry, [10, 20, 9])).toEqual({ column: 20, row: 40, depthMm: 4 });
  });

  it("Pixel coordinates refer to corners: the first pixel's centre is at (0.5, 0.5).", () => {
    const geometry = geometryOf({ ...none, lps_from_pixel: flat([1, 0, 0], [0, 1, 0], [0, 0, 0], 2, 2) });
    if (geometry?.kind !== "flat") throw new Error("a matrix gives a flat picture");
    expect(lpsFromPixel(geometry, { column: 0.5, row: 0.5 })).toEqual([1, 1, 0]);
    expect(mmPerPixel(geometry)).toBe(2);
  });

  it("pixelFromLps returns null for a matrix without area.", () => {
    const geometry = geometryOf({ ...none, lps_from_pixel: new Array(16).fill(0) });
    if (geometry === null) throw new Error("a matrix gives a geometry");
    expect(pixelFromLps(geometry, [1, 2, 3])).toBeNull();
  });
});

describe("camera pictures", () => {
  const identity = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];

  it("A point is where the moved patient has it, if a breathing makes the matrix affine.", () => {
    // The patient is compressed to 80 % along z; the camera of the moved patient looks along -z from (0, 0, 80).
    const camera = [1, 0, 0, 0, 0, -1, 0, 0, 0, 0, -1, 80, 0, 0, 0, 1];
    const restFromCamera = [1, 0, 0, 0, 0, -1, 0, 0, 0, 0, -1 / 0.8, 100, 0, 0, 0, 1];
    const moved = geometryOf({ ...none, lps_from_camera: restFromCamera, fov_deg: 90, breathes: true });
    const still = geometryOf({ ...none, lps_from_camera: camera, fov_deg: 90 });
    if (moved === null || still === null) throw new Error("a camera gives a geometry");
    const seen = pixelFromLps(moved, [7, -3, 50]);
    const expected = pixelFromLps(still, [7, -3, 40]);
    expect(seen?.column).toBeCloseTo(expected?.column ?? 0, 9);
    expect(seen?.row).toBeCloseTo(expected?.row ?? 0, 9);
    expect(seen?.depthMm).toBeCloseTo(40, 9);
  });

  it("The viewing direction is in the middle, and half the field of view at the edge of the shorter side.", () => {
    const geometry = geometryOf({ ...none, lps_from_camera: identity, fov_deg: 90 });
    if (geometry === null) throw new Error("a camera gives a geometry");
    expect(pixelFromLps(geometry, [0, 0, 10])).toEqual({ column: 100, row: 50, depthMm: 10 });
    const edge = pixelFromLps(geometry, [0, 10, 10]);
    expect(edge?.row).toBeCloseTo(100);
    expect(pixelFromLps(geometry, [10, 0, 10])?.column).toBeCloseTo(150);
  });

  it("A point behind the camera has no pixel, and a line is split there.", () => {
    const geometry = geometryOf({ ...none, lps_from_camera: identity, fov_deg: 90 });
    if (geometry === null) throw new Error("a camera gives a geometry");
    expect(pixelFromLps(geometry, [0, 0, -1])).toBeNull();
    const runs = projectLine(geometry, [
      [0, 0, 5],
      [0, 0, 3],
      [0, 0, -3],
      [1, 0, -3],
      [1, 0, 4],
      [1, 0, 6],
    ]);
    expect(runs.map((run) => run.length)).toEqual([2, 2]);
  });

  it("All points on a ray have the same pixel for any camera.", () => {
    const random = randomOf(12);
    for (let round = 0; round < 200; round += 1) {
      const { right, down, forward } = randomAxes(random);
      const at: Vec3 = [30 * random(), -20 * random(), 500 * random()];
      const matrix = [
        ...[right[0], down[0], forward[0], at[0]],
        ...[right[1], down[1], forward[1], at[1]],
        ...[right[2], down[2], forward[2], at[2]],
        ...[0, 0, 0, 1],
      ];
      const geometry = geometryOf({ ...none, lps_from_camera: matrix, fov_deg: 60 + 100 * random() });
      if (geometry === null) throw new Error("a camera gives a geometry");
      const dir = add(add(forward, scale(right, random() - 0.5)), scale(down, random() - 0.5));
      const near = pixelFromLps(geometry, add(at, scale(dir, 3)));
      const far = pixelFromLps(geometry, add(at, scale(dir, 90)));
      expect(near?.column).toBeCloseTo(far?.column ?? Number.NaN, 6);
      expect(near?.row).toBeCloseTo(far?.row ?? Number.NaN, 6);
    }
  });
});

describe("lenses", () => {
  const file = fileURLToPath(new URL("../../../tests/golden/projections.json", import.meta.url));
  const cases = JSON.parse(readFileSync(file, "utf-8")) as (Placed & {
    name: string;
    points_lps: [number, number, number][];
    pixels: ([number, number] | null)[];
  })[];

  it.each(cases.map((made) => [made.name, made] as const))("Pixels equal those of Python: %s", (_name, made) => {
    const geometry = geometryOf({ ...made, lps_from_pixel: null });
    if (geometry === null) throw new Error("a camera gives a geometry");
    expect(made.pixels.filter((pixel) => pixel !== null).length).toBeGreaterThan(9);
    made.points_lps.forEach((point, index) => {
      const expected = made.pixels[index];
      const found = pixelFromLps(geometry, point);
      if (expected == null) {
        expect(found).toBeNull();
        return;
      }
      // Tolerance 1e-6 px: the same formulas in double precision, with values read from a file.
      expect(found?.column).toBeCloseTo(expected[0], 6);
      expect(found?.row).toBeCloseTo(expected[1], 6);
    });
  });

  it("A circle around a fisheye camera is split where it passes behind the camera.", () => {
    const fisheye = cases.find((made) => made.lens?.model === "fisheye");
    if (fisheye === undefined) throw new Error("there is a fisheye among the lenses");
    const geometry = geometryOf({
      ...fisheye,
      lps_from_pixel: null,
      lps_from_camera: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1],
    });
    if (geometry === null) throw new Error("a camera gives a geometry");
    const round: Vec3[] = Array.from({ length: 73 }, (_, step) => {
      const angle = (step * 5 * Math.PI) / 180;
      return [10 * Math.sin(angle), 0, 10 * Math.cos(angle)];
    });
    for (const run of projectLine(geometry, round)) {
      for (let index = 1; index < run.length; index += 1) {
        expect(Math.abs((run[index]?.column ?? 0) - (run[index - 1]?.column ?? 0))).toBeLessThan(20);
      }
    }
  });
});

describe("scaleBar", () => {
  it("Its length is 1, 2 or 5 times a power of ten and fits into the given width.", () => {
    for (const mmPerPx of [0.013, 0.4, 0.66, 1, 3.7]) {
      const bar = scaleBar(mmPerPx, 90);
      expect(bar.px).toBeLessThanOrEqual(90);
      expect(bar.px).toBeGreaterThan(30);
      expect(bar.px * mmPerPx).toBeCloseTo(bar.mm);
      expect([1, 2, 5]).toContain(Number(bar.mm.toExponential(0).split("e")[0]));
    }
  });

  it("distance returns the Euclidean distance of two points.", () => {
    expect(distance([0, 0, 0], [0, 3, 4])).toBe(5);
  });
});
