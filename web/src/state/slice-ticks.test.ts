import { describe, expect, it } from "vitest";
import { sliceTicks } from "./slice-ticks";

const CT = { shape_zyx: [21, 8, 8] as [number, number, number], tilt_deg: null, interpolated_slices: [4] };

describe("sliceTicks", () => {
  it("places measured slices in proportion to their index, also between even slices.", () => {
    const ticks = sliceTicks({ ...CT, slice_places: [0, 2.5, 20] }, 216);
    expect(ticks.measuredPx).toEqual([8, 33, 208]);
    expect(ticks.leanPx).toBe(0);
  });

  it("centres the mark of an interpolated slice on its place.", () => {
    const [mark] = sliceTicks({ ...CT, slice_places: [0, 20] }, 216).interpolatedPx;
    expect(mark).toEqual({ slice: 4, x: 43, width: 10 });
  });

  it("leans the lines by the gantry tilt.", () => {
    expect(sliceTicks({ ...CT, tilt_deg: 45, slice_places: [0, 20] }, 216).leanPx).toBeCloseTo(22);
  });
});
