import { describe, expect, test } from "vitest";
import { numInView, sectionOf } from "./section";
import type { Vec3 } from "./vec";

const TETRAHEDRON = {
  vertices: [
    [0, 0, 0],
    [2, 0, 0],
    [0, 2, 0],
    [0, 0, 2],
  ] as Vec3[],
  triangles: [0, 2, 1, 0, 1, 3, 1, 2, 3, 0, 3, 2],
};

describe("sectionOf", () => {
  test("A plane through a closed surface gives a closed line in the plane.", () => {
    const lines = sectionOf(TETRAHEDRON, [0, 0, 1], [0, 0, 1]);
    expect(lines).toHaveLength(3);
    const ends = lines.flat().map((point) => point.map((v) => v.toFixed(6)).join(","));
    for (const end of ends) {
      expect(ends.filter((other) => other === end)).toHaveLength(2);
      expect(end.endsWith("1.000000")).toBe(true);
    }
  });

  test("A plane beside the surface gives no lines.", () => {
    expect(sectionOf(TETRAHEDRON, [0, 0, 5], [0, 0, 1])).toEqual([]);
  });
});

describe("numInView", () => {
  const straight = Array.from({ length: 30 }, (_, n): Vec3 => [0, 0, 6 + n]);
  test("All points of a straight tube are in view.", () => {
    expect(
      numInView(
        [0, 0, 0],
        straight,
        straight.map(() => 3),
      ),
    ).toBe(30);
  });

  test("A bend hides the points beyond it, and hides more of them in a narrow tube than in a wide one.", () => {
    const bent = [...straight, ...Array.from({ length: 30 }, (_, n): Vec3 => [1 + n, 0, 35])];
    const wide = numInView(
      [0, 0, 0],
      bent,
      bent.map(() => 4),
    );
    const narrow = numInView(
      [0, 0, 0],
      bent,
      bent.map(() => 1.5),
    );
    expect(wide).toBeGreaterThan(30);
    expect(wide).toBeLessThan(55);
    expect(narrow).toBeLessThan(wide);
    expect(narrow).toBeGreaterThanOrEqual(30);
  });
});
