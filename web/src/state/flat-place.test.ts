import { describe, expect, it } from "vitest";
import { type FlatPlace, panned, zoomedAbout } from "./flat-place";
import { add, scale, type Vec3 } from "./vec";

const AXES = { right: [0, 1, 0], down: [0, 0, -1] } as const;
const PLACE: FlatPlace = { mmPerPx: 0.5, middle: [10, 20, 30] };

/** Return the patient point (LPS mm) of a picture position, which is given in pixels from the picture's middle. */
const pointAt = (place: FlatPlace, right: number, down: number): Vec3 =>
  add(
    place.middle,
    add(
      scale(AXES.right as unknown as Vec3, right * place.mmPerPx),
      scale(AXES.down as unknown as Vec3, down * place.mmPerPx),
    ),
  );

describe("position of a planar view", () => {
  it("Zoom keeps the patient point under the cursor at the same place.", () => {
    const near = zoomedAbout(PLACE, AXES as never, 0.1, { right: 60, down: -40 });
    expect(near.mmPerPx).toBe(0.1);
    pointAt(near, 60, -40).forEach((value, axis) => {
      expect(value).toBeCloseTo(pointAt(PLACE, 60, -40)[axis] ?? Number.NaN, 9);
    });
  });

  it("Pan keeps the patient point under the hand at the same place.", () => {
    const there = panned(PLACE, AXES as never, { right: 25, down: 10 });
    expect(there.mmPerPx).toBe(PLACE.mmPerPx);
    pointAt(there, 25 + 7, 10 - 3).forEach((value, axis) => {
      expect(value).toBeCloseTo(pointAt(PLACE, 7, -3)[axis] ?? Number.NaN, 9);
    });
  });
});
