import { describe, expect, it } from "vitest";
import { clipPathOf, isInside, type Shape, shapeOf } from "./outline";

const FRAME = { x: 10, y: 20, width: 200, height: 200 };
const at = (x: number, y: number) => ({ x: 110 + x, y: 120 + y });

describe("shape of a picture", () => {
  it("isInside contains the middle and half the width, and corner points only if the shape contains them.", () => {
    const inside = (x: number, y: number) =>
      (["fill", "octagon", "round"] as Shape[]).map((shape) => isInside(shape, FRAME, at(x, y)));
    expect(inside(0, 0)).toEqual([true, true, true]);
    expect(inside(-99, 0)).toEqual([true, true, true]);
    expect(inside(0, 101)).toEqual([false, false, false]);
    // A point beside the top: inside the octagon, outside the circle.
    expect(inside(40, -99)).toEqual([true, true, false]);
    expect(inside(80, 80)).toEqual([true, false, false]);
    expect(inside(99, 99)).toEqual([true, false, false]);
  });

  it("The CSS clip path of an octagon equals the shape of isInside.", () => {
    const corners = [...clipPathOf("octagon").matchAll(/([\d.]+)% ([\d.]+)%/g)].map((match) => ({
      x: FRAME.x + (Number(match[1]) / 100) * FRAME.width,
      y: FRAME.y + (Number(match[2]) / 100) * FRAME.height,
    }));
    expect(corners).toHaveLength(8);
    for (const corner of corners) {
      const towards = (part: number) => at((corner.x - 110) * part, (corner.y - 120) * part);
      expect(isInside("octagon", FRAME, towards(0.999))).toBe(true);
      expect(isInside("octagon", FRAME, towards(1.001))).toBe(false);
    }
    expect(clipPathOf("fill")).toBe("none");
  });

  it("shapeOf returns the shape of each outline setting.", () => {
    expect((["none", "round", "octagon"] as const).map(shapeOf)).toEqual(["fill", "round", "octagon"]);
  });
});
