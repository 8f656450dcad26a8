import { describe, expect, it } from "vitest";
import { chartScale, measuredPoints, nearestSection, type ProfilePoint, runsOf } from "./profile";

const point = (atMm: number, lumenMm: number, atJunction = false): ProfilePoint => ({
  atMm,
  lumenMm,
  errorMm: 0.2,
  atJunction,
});

describe("chart of a branch", () => {
  it("measuredPoints leaves out sections without a lumen and marks the sections at forks.", () => {
    const points = measuredPoints({
      at_mm: [0, 1, 2, 3],
      lumen_mm: [9, 6, null, 5],
      lumen_error_mm: [0.5, null, null, 0.1],
      min_mm: [null, null, null, null],
      max_mm: [null, null, null, null],
      wall_mm: [null, null, null, null],
      at_junction: [true, false, false, false],
    });
    expect(points.map((entry) => entry.atMm)).toEqual([0, 1, 3]);
    expect(points[0]?.atJunction).toBe(true);
    expect(points[1]?.errorMm).toBeNull();
  });

  it("runsOf splits the line at a fork.", () => {
    const runs = runsOf([point(0, 5), point(1, 5), point(2, 9, true), point(3, 5)]);
    expect(runs.map((run) => run.map((entry) => entry.atMm))).toEqual([[0, 1], [3]]);
    expect(runsOf([point(0, 5, true)])).toEqual([]);
  });

  it("The diameter axis starts at 0 mm and has round tick values.", () => {
    const scale = chartScale([point(0, 4.9), point(20, 2)], 100, 50);
    expect(scale.ticksMm).toEqual([0, 2, 4, 6]);
    expect([scale.x(0), scale.x(20), scale.y(0), scale.y(6)]).toEqual([0, 100, 50, 0]);
    expect(chartScale([point(0, 0.4)], 100, 50).topMm).toBe(1);
  });

  it("nearestSection returns the section nearest to the cursor, and null for an empty list.", () => {
    expect(nearestSection([point(0, 1), point(2, 1), point(5, 1)], 3)?.atMm).toBe(2);
    expect(nearestSection([], 3)).toBeNull();
  });
});
