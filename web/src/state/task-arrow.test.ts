import { describe, expect, it } from "vitest";
import { buildTree } from "./airways";
import { testBranch } from "./branches.testing";
import { arrowText, taskArrow } from "./task-arrow";
import { cameraFromMatrix } from "./vec";

/** Trachea (0) down to a fork; its children go to the patient's right (1) and left (2); 3 and 4 continue from 1. */
const line = (...points: [number, number, number][]) => ({ points, radius: points.map(() => 4) });
const tree = buildTree({
  format: "carina-tree",
  version: 1,
  space: "LPS",
  unit: "mm",
  root: 0,
  branches: [
    testBranch(0, null, [1, 2], line([0, 0, 0], [0, 0, -50])),
    testBranch(1, 0, [3, 4], line([0, 0, -50], [-20, 0, -60], [-40, 0, -70])),
    testBranch(2, 0, [], line([0, 0, -50], [20, 0, -60], [40, 0, -70])),
    testBranch(3, 1, [], line([-40, 0, -70], [-40, -20, -75])),
    testBranch(4, 1, [], line([-40, 0, -70], [-60, 0, -72])),
  ],
});
/** Camera that looks down the trachea at a height; its right is the patient's left, its down the patient's back. */
const down = (z: number, x = 0) => cameraFromMatrix([1, 0, 0, x, 0, 1, 0, 0, 0, 0, -1, z, 0, 0, 0, 1]);

describe("the arrow of a task", () => {
  it("points to the opening of the next branch at its clock hour", () => {
    expect(taskArrow(tree, { branch_id: 0 }, down(-40), [4])).toEqual({ kind: "turn", hour: 9 });
    expect(taskArrow(tree, { branch_id: 0 }, down(-40), [2])).toEqual({ kind: "turn", hour: 3 });
    expect(taskArrow(tree, { branch_id: 1 }, down(-60, -40), [3])).toEqual({ kind: "turn", hour: 12 });
  });

  it("points straight ahead from far away, and in the branch of the step", () => {
    expect(taskArrow(tree, { branch_id: 0 }, down(100), [2])).toEqual({ kind: "ahead" });
    expect(taskArrow(tree, { branch_id: 2 }, down(-60, 20), [2])).toEqual({ kind: "ahead" });
    expect(taskArrow(tree, { branch_id: 3 }, down(-72, -40), [1])).toEqual({ kind: "ahead" });
  });

  it("points back from a branch that does not lead to the step", () => {
    expect(taskArrow(tree, { branch_id: 2 }, down(-60, 20), [3])).toEqual({ kind: "back" });
    expect(taskArrow(tree, { branch_id: 4 }, down(-71, -50), [3])).toEqual({ kind: "back" });
  });

  it("leads to the part of a segment that is nearest in the tree", () => {
    expect(taskArrow(tree, { branch_id: 1 }, down(-60, -40), [2, 3])).toEqual({ kind: "turn", hour: 12 });
  });

  it("is absent without a step, a tree or an airway", () => {
    expect(taskArrow(tree, { branch_id: 0 }, down(-40), [])).toBeNull();
    expect(taskArrow(null, { branch_id: 0 }, down(-40), [2])).toBeNull();
    expect(taskArrow(tree, { branch_id: null }, down(-40), [2])).toBeNull();
    expect(taskArrow(tree, { branch_id: 0 }, down(-40), [99])).toBeNull();
  });

  it("agrees with its text", () => {
    expect(arrowText({ kind: "turn", hour: 3 })).toBe("Turn to 3 o\u2019clock");
    expect(arrowText({ kind: "back" })).toBe("Withdraw");
    expect(arrowText({ kind: "ahead" })).toBe("Straight ahead");
  });
});
