import { describe, expect, it } from "vitest";
import { multiply, penOrientation, type Turned, type Wxyz } from "./orientation";

type Vec = readonly [number, number, number];

function rotate(q: Wxyz, v: Vec): Vec {
  const [, x, y, z] = multiply(multiply(q, [0, ...v]), [q[0], -q[1], -q[2], -q[3]]);
  return [x, y, z];
}

function close(found: Vec, expected: Vec): void {
  for (const axis of [0, 1, 2] as const) expect(found[axis]).toBeCloseTo(expected[axis], 12);
}

const of = (alpha: number, beta: number, gamma: number): Wxyz => {
  const q = penOrientation({ alpha, beta, gamma });
  if (q === null) throw new Error("an orientation was expected");
  return q;
};

const RIGHT: Vec = [1, 0, 0];
const DOWN: Vec = [0, 1, 0];
const FORWARD: Vec = [0, 0, 1];

/** Return the rotation matrix of the W3C Device Orientation specification, section 4.1 (example Z-X'-Y''). */
function w3c({ alpha, beta, gamma }: { alpha: number; beta: number; gamma: number }): number[][] {
  const rad = Math.PI / 180;
  const [cx, cy, cz] = [Math.cos(beta * rad), Math.cos(gamma * rad), Math.cos(alpha * rad)];
  const [sx, sy, sz] = [Math.sin(beta * rad), Math.sin(gamma * rad), Math.sin(alpha * rad)];
  return [
    [cz * cy - sz * sx * sy, -cx * sz, cy * sz * sx + cz * sy],
    [cy * sz + cz * sx * sy, cz * cx, sz * sy - cz * cy * sx],
    [-cx * sy, sx, cx * cy],
  ];
}

describe("penOrientation", () => {
  it("For a phone that lies flat with its upper edge to the north, forward is north and down is down.", () => {
    close(rotate(of(0, 0, 0), FORWARD), [0, 1, 0]);
    close(rotate(of(0, 0, 0), RIGHT), [1, 0, 0]);
    close(rotate(of(0, 0, 0), DOWN), [0, 0, -1]);
  });

  it("Forward is up at beta 90, and west at alpha 90.", () => {
    close(rotate(of(0, 90, 0), FORWARD), [0, 0, 1]);
    close(rotate(of(90, 0, 0), FORWARD), [-1, 0, 0]);
  });

  it("At gamma 90 the pen's right points down, and forward does not change.", () => {
    close(rotate(of(0, 0, 90), FORWARD), [0, 1, 0]);
    close(rotate(of(0, 0, 90), RIGHT), [0, 0, -1]);
  });

  it("The rotation equals the matrix of the W3C specification for several sets of angles.", () => {
    for (const [alpha, beta, gamma] of [
      [12, 34, 56],
      [359.9, -179.5, 89.9],
      [200, 91, -45],
      [0.001, -0.002, 0.003],
    ] as const) {
      const matrix = w3c({ alpha, beta, gamma });
      const axes: readonly [Vec, Vec][] = [
        [RIGHT, [1, 0, 0]],
        [FORWARD, [0, 1, 0]],
        [DOWN, [0, 0, -1]],
      ];
      for (const [pen, device] of axes) {
        const at = (row: number) =>
          device.reduce((sum, v, column) => sum + (matrix[row]?.[column] ?? Number.NaN) * v, 0);
        close(rotate(of(alpha, beta, gamma), pen), [at(0), at(1), at(2)]);
      }
    }
  });

  it("The quaternion has unit length for all angles.", () => {
    for (let n = 0; n < 200; n += 1) {
      const q = of((n * 37) % 360, ((n * 53) % 360) - 180, ((n * 29) % 180) - 90);
      expect(Math.hypot(...q)).toBeCloseTo(1, 12);
    }
  });

  it("returns null for a missing or non-finite angle", () => {
    const bad: Turned[] = [
      { alpha: null, beta: 0, gamma: 0 },
      { alpha: 0, beta: Number.NaN, gamma: 0 },
      { alpha: 0, beta: 0, gamma: Number.POSITIVE_INFINITY },
    ];
    for (const turned of bad) expect(penOrientation(turned)).toBeNull();
  });
});
