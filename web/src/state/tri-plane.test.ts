import { describe, expect, it } from "vitest";
import { type Geometry, geometryOf, pixelFromLps, type SeenGeometry } from "./projection";
import { dragMm, isInside, outlineOf, planeUnder } from "./tri-plane";
import type { Vec3 } from "./vec";

/** An oblique, anisotropic box around the origin: i mostly along +y, j along -x, k along +z, tilted by 10 degrees. */
const c = Math.cos(0.17);
const s = Math.sin(0.17);
const STEPS = [
  [0, 2 * c, 2 * s],
  [-3, 0, 0],
  [0, -2.5 * s, 2.5 * c],
] as const;
const SHAPE = [40, 30, 50] as const;
const half = [(SHAPE[2] - 1) / 2, (SHAPE[1] - 1) / 2, (SHAPE[0] - 1) / 2] as const;
const origin = [0, 1, 2].map((a) => -STEPS.reduce((sum, step, n) => sum + (step[a] ?? 0) * (half[n] ?? 0), 0));
const GRID = {
  shape_zyx: SHAPE,
  lps_from_ijk: [0, 1, 2]
    .flatMap((row) => [...STEPS.map((step) => step[row] ?? 0), origin[row] ?? 0])
    .concat([0, 0, 0, 1]),
};

/** Return a camera anterior, left and above, 400 mm from the origin, which looks at the origin. */
function camera(): SeenGeometry {
  const [azimuth, elevation] = [0.6, 0.4];
  const out: Vec3 = [
    Math.sin(azimuth) * Math.cos(elevation),
    -Math.cos(azimuth) * Math.cos(elevation),
    Math.sin(elevation),
  ];
  const right: Vec3 = [Math.cos(azimuth), Math.sin(azimuth), 0];
  const down: Vec3 = [
    -(out[1] * right[2] - out[2] * right[1]),
    -(out[2] * right[0] - out[0] * right[2]),
    -(out[0] * right[1] - out[1] * right[0]),
  ];
  const rows = [0, 1, 2].flatMap((a) => [right[a] ?? 0, down[a] ?? 0, -(out[a] ?? 0), 400 * (out[a] ?? 0)]);
  const geometry: Geometry | null = geometryOf({
    width: 200,
    height: 160,
    lps_from_pixel: null,
    lps_from_camera: [...rows, 0, 0, 0, 1],
    fov_deg: 25,
    lens: null,
  });
  if (geometry === null || geometry.kind !== "seen") throw new Error("no camera");
  return geometry;
}

const CENTRE: Vec3 = [5, -4, 6];

describe("planes of the tri-plane view", () => {
  const geometry = camera();

  it("planeUnder returns the plane that the camera sees at the pixel, with the point on it.", () => {
    for (const [plane, lps] of [
      ["axial", [15, -14, 6]],
      ["coronal", [20, -4, 20]],
      ["sagittal", [5, -20, 20]],
    ] as const) {
      const pixel = pixelFromLps(geometry, lps);
      if (pixel === null) throw new Error("not seen");
      const hit = planeUnder(geometry, GRID, CENTRE, pixel);
      expect(hit?.plane).toBe(plane);
      hit?.lps.forEach((value, axis) => {
        expect(value).toBeCloseTo(lps[axis] ?? Number.NaN, 6);
      });
    }
  });

  it("The nearest plane hides the others, and the background gives null.", () => {
    // Below the axial plane, but seen from above, the ray meets the axial plane first.
    const pixel = pixelFromLps(geometry, [5, -4, -10]);
    if (pixel === null) throw new Error("not seen");
    expect(planeUnder(geometry, GRID, CENTRE, pixel)?.plane).toBe("axial");
    expect(planeUnder(geometry, GRID, CENTRE, { column: 1, row: 1 })).toBeNull();
  });

  it("outlineOf returns corners on the plane and on the box, and none for a plane outside the volume.", () => {
    for (const axis of [0, 1, 2] as const) {
      const outline = outlineOf(GRID, CENTRE, axis);
      expect(outline.length).toBeGreaterThanOrEqual(4);
      for (const corner of outline) {
        expect(corner[axis]).toBeCloseTo(CENTRE[axis], 9);
        expect(isInside(GRID, [corner[0] * 0.999, corner[1] * 0.999, corner[2] * 0.999])).toBe(true);
        expect(isInside(GRID, [corner[0] * 1.2, corner[1] * 1.2, corner[2] * 1.2])).toBe(false);
      }
    }
    expect(outlineOf(GRID, [900, 0, 0], 0)).toEqual([]);
  });

  it("A drag along the projected normal moves the plane by that distance, and a perpendicular drag by 0.", () => {
    const lps: Vec3 = [15, -14, 6];
    const grabbed = { plane: "axial", axis: 2, lps } as const;
    const from = pixelFromLps(geometry, lps);
    const to = pixelFromLps(geometry, [15, -14, 9]);
    if (from === null || to === null) throw new Error("not seen");
    const mm = dragMm(geometry, grabbed, { dx: to.column - from.column, dy: to.row - from.row });
    // 3 mm, slightly reduced by perspective.
    expect(mm).toBeCloseTo(3, 1);
    // A drag perpendicular to the projected normal moves nothing.
    expect(dragMm(geometry, grabbed, { dx: -(to.row - from.row), dy: to.column - from.column })).toBeCloseTo(0, 6);
  });

  it("If the normal points to the viewer, an upward drag moves the plane nearer.", () => {
    // Seen straight from above, the axial plane's normal projects to a point.
    const above = geometryOf({
      width: 200,
      height: 200,
      lps_from_pixel: null,
      lps_from_camera: [1, 0, 0, 0, 0, -1, 0, 0, 0, 0, -1, 400, 0, 0, 0, 1],
      fov_deg: 25,
      lens: null,
    });
    if (above === null || above.kind !== "seen") throw new Error("no camera");
    const grabbed = { plane: "axial", axis: 2, lps: [3, 4, 6] } as const;
    expect(dragMm(above, grabbed, { dx: 0, dy: -10 })).toBeGreaterThan(0);
    expect(dragMm(above, grabbed, { dx: 0, dy: 10 })).toBeLessThan(0);
  });
});
