import { describe, expect, it } from "vitest";
import type { PickedMessage } from "../wire/messages";
import { addPick, pointsApartMm, type WallPoint, wallPointLines } from "./wall-point";

const answer = (lps: PickedMessage["lps"], change: Partial<PickedMessage> = {}): PickedMessage => ({
  type: "picked",
  pick_id: 1,
  lps,
  depth_mm: lps === null ? null : 14.25,
  voxel_value: lps === null ? null : -412,
  branch_id: 4,
  branch_name: "RUL",
  generation: 2,
  ...change,
});

const picked = (...answers: PickedMessage[]): readonly WallPoint[] =>
  answers.reduce(addPick, [] as readonly WallPoint[]);

describe("wall points", () => {
  it("The lines state position, airway, distance from the lens and voxel value in HU.", () => {
    expect(wallPointLines(picked(answer([-12.34, -4.5, 100.2])), null, true)).toEqual([
      "R\u202f12.3  A\u202f4.5  S\u202f100.2 mm",
      "RUL, generation 2",
      "14.3\u202fmm away when clicked",
      "\u2212412 HU",
    ]);
  });

  it("The lines state that values are not HU, and leave out unknown facts.", () => {
    const bare = answer([1, 2, 3], { branch_id: null, branch_name: null, generation: null });
    expect(wallPointLines(picked(bare), null, false).slice(2)).toEqual(["\u2212412 (not HU)"]);
    const unnamed = answer([1, 2, 3], { branch_name: null, generation: 6, voxel_value: null });
    expect(wallPointLines(picked(unnamed), "branch 17", true).slice(1)).toEqual([
      "branch 17, generation 6",
      "14.3\u202fmm away when clicked",
    ]);
  });

  it("The distance of the last two points is stated, and a third point replaces the oldest.", () => {
    const two = picked(answer([0, 0, 0]), answer([3, 4, 0]));
    expect(pointsApartMm(two)).toBeCloseTo(5);
    expect(wallPointLines(two, null, true).at(-1)).toBe("5.0\u202fmm apart");
    const three = addPick(two, answer([3, 4, 12]));
    expect(three).toHaveLength(2);
    expect(pointsApartMm(three)).toBeCloseTo(12);
    expect(pointsApartMm(picked(answer([0, 0, 0])))).toBeNull();
  });

  it("A click that hits no wall adds no point.", () => {
    const one = picked(answer([1, 2, 3]));
    expect(addPick(one, answer(null))).toBe(one);
    expect(wallPointLines([], null, true)).toEqual([]);
  });
});
