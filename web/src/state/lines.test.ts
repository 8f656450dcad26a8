import { describe, expect, it } from "vitest";
import type { PictureLines } from "../wire/messages";
import { axesAt, linesOf, lpsAt, nearestPixel, pathMmAt, pixelOfPath } from "./lines";

/**
 * A picture 100 px wide with 0.5 mm per px: 20 mm down, then 20 mm to the patient's left, with 5 mm of straight rows
 * beyond each end.
 */
const LINES: PictureLines = {
  row: [0.5, 10.5, 50.5, 90.5, 100.5],
  start_lps: [
    [-25, 0, 5],
    [-25, 0, 0],
    [-25, 0, -20],
    [-5, 0, -20],
    [0, 0, -20],
  ],
  step_lps: Array.from({ length: 5 }, () => [0.5, 0, 0] as const),
  path_mm: [0, 0, 20, 40, 40],
  path_column: [50, 50, 50, 50, 50],
  mm_per_px: 0.5,
};

describe("geometry of pictures along a route", () => {
  const geometry = linesOf(LINES);
  if (geometry === null) throw new Error("no geometry");

  it("lpsAt returns the patient point of a pixel, and clamps rows outside the picture to its edge.", () => {
    expect(lpsAt(geometry, { column: 0, row: 30.5 })).toEqual([-25, 0, -10]);
    expect(lpsAt(geometry, { column: 100, row: 30.5 })).toEqual([25, 0, -10]);
    expect(lpsAt(geometry, { column: 50, row: 70.5 })).toEqual([10, 0, -20]);
    // Rows outside the picture count as its edge.
    expect(lpsAt(geometry, { column: 50, row: -40 })).toEqual([0, 0, 5]);
  });

  it("pathMmAt and pixelOfPath convert between rows and route positions; a position beyond the route has no pixel.", () => {
    expect(pathMmAt(geometry, 30.5)).toBe(10);
    expect(pathMmAt(geometry, 3)).toBe(0);
    expect(pathMmAt(geometry, 99)).toBe(40);
    expect(pixelOfPath(geometry, 10)).toEqual({ column: 50, row: 30.5 });
    expect(pixelOfPath(geometry, 0)).toEqual({ column: 50, row: 10.5 });
    expect(pixelOfPath(geometry, 40)).toEqual({ column: 50, row: 90.5 });
    expect(pixelOfPath(geometry, 41)).toBeNull();
    expect(pixelOfPath(geometry, -1)).toBeNull();
  });

  it("nearestPixel returns the nearest pixel of a point and the point's distance from the surface.", () => {
    const found = nearestPixel(geometry, [6, 3, -10]);
    expect(found.column).toBeCloseTo(62, 6);
    expect(found.row).toBeCloseTo(30.5, 6);
    expect(found.awayMm).toBeCloseTo(3, 6);
  });

  it("axesAt returns the directions to the right, at the start of the route and at its end.", () => {
    const { right, up, down } = axesAt(geometry);
    expect(right[0]).toBeGreaterThan(0);
    // The route begins towards the feet and ends towards the patient's left.
    expect(up).toEqual([0, 0, 6]);
    expect(down).toEqual([6, 0, 0]);
  });

  it("linesOf returns null for a header without lines or with one row.", () => {
    expect(linesOf(null)).toBeNull();
    expect(linesOf({ ...LINES, row: [0.5] })).toBeNull();
  });
});
