import { describe, expect, it } from "vitest";
import { pinchScrollPx, ZOOM_PER_PX } from "./pointer";
import { deflectionOf } from "./stick";

describe("deflectionOf", () => {
  it("is 0 around the middle, and full at the edge in the direction of the thumb", () => {
    expect(deflectionOf(58, 58, 116)).toEqual({ right: 0, down: 0 });
    expect(deflectionOf(62, 58, 116)).toEqual({ right: 0, down: 0 });
    expect(deflectionOf(116, 58, 116)).toEqual({ right: 1, down: 0 });
    expect(deflectionOf(58, -200, 116).down).toBe(-1);
  });

  it("grows more slowly near the middle than near the edge", () => {
    const at = (x: number) => deflectionOf(58 + x, 58, 116).right;
    expect(at(29)).toBeLessThan(0.25);
    expect(at(29)).toBeGreaterThan(0);
    expect(at(58) - at(43)).toBeGreaterThan(at(29) - at(14));
  });
});

describe("pinchScrollPx", () => {
  it("zooms by the ratio of the distances between the fingers", () => {
    expect(Math.exp(pinchScrollPx(100, 200) * ZOOM_PER_PX)).toBeCloseTo(0.5);
    expect(pinchScrollPx(200, 100)).toBeCloseTo(-pinchScrollPx(100, 200));
  });

  it("does not zoom while both fingers are closer than a fingertip", () => {
    expect(pinchScrollPx(3, 20)).toBeCloseTo(0);
  });
});
