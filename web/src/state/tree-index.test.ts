import { describe, expect, it } from "vitest";
import type { TreeBranch } from "../wire/messages";
import { type BranchTree, buildTree } from "./airways";
import { testBranch } from "./branches.testing";
import { forkOf } from "./fork-choice";
import type { SeenGeometry } from "./projection";
import { below, branchAhead, nearestPlace, placeFromOutside, placeInLumen, pointsFrom } from "./tree-index";

type Point = [number, number, number];

function branch(
  id: number,
  parent: number | null,
  children: number[],
  from: Point,
  to: Point,
  radius: number,
): TreeBranch {
  const points = Array.from({ length: 21 }, (_, n): Point => {
    const t = n / 20;
    return [from[0] + t * (to[0] - from[0]), from[1] + t * (to[1] - from[1]), from[2] + t * (to[2] - from[2])];
  });
  return testBranch(id, parent, children, { points, radius: points.map(() => radius) });
}

/**
 * Return a tree with a trunk that leads down to a fork, a right (-x) and a left (+x) branch, and a branch behind the
 * left one as seen from the front.
 */
function made(): BranchTree {
  const tree = buildTree({
    format: "carina-tree",
    version: 1,
    space: "LPS",
    unit: "mm",
    root: 0,
    branches: [
      branch(0, null, [1, 2], [0, 0, 0], [0, 0, -40], 8),
      branch(1, 0, [], [0, 0, -40], [-40, 0, -60], 5),
      branch(2, 0, [3], [0, 0, -40], [40, 0, -60], 5),
      branch(3, 2, [], [40, 0, -60], [40, 30, -58], 2),
    ],
  });
  if (tree === null) throw new Error("no tree");
  return tree;
}

/**
 * A camera 200 mm in front of the patient (anterior) that looks straight back: +x of the picture is the patient's left.
 */
const FRONT: SeenGeometry = {
  kind: "seen",
  camera: { right: [1, 0, 0], down: [0, 0, -1], forward: [0, 1, 0], position: [0, -200, -40] },
  focalPx: 400,
  lens: null,
  width: 400,
  height: 400,
};
const onScreen = (x: number, y: number, z: number) => {
  const perMm = 400 / (y + 200);
  return { column: 200 + x * perMm, row: 200 + (-z - 40) * perMm };
};

const TREE = made();

describe("branch under the cursor", () => {
  it("In a slice it is the branch whose lumen contains the point, although another centreline may be nearer.", () => {
    expect(placeInLumen(TREE.index, [6, 0, -20])?.branchId).toBe(0);
    expect(placeInLumen(TREE.index, [-30, 0, -55])?.branchId).toBe(1);
    expect(placeInLumen(TREE.index, [0, 30, -20])).toBeNull();
    // A point nearer to the thin branch's centreline than to the thick one's, but inside the thick branch only.
    expect(placeInLumen(TREE.index, [36, 4, -58])?.branchId).toBe(2);
  });

  it("nearestPlace returns the distance along the branch.", () => {
    expect(nearestPlace(TREE.index, [3, 1, -20])).toMatchObject({ branchId: 0, alongMm: 20 });
  });

  it("In an outside view it is the frontmost branch, and a thin branch is found a few pixels beside it.", () => {
    expect(placeFromOutside(TREE.index, FRONT, onScreen(0, 0, -20), 1)?.branchId).toBe(0);
    expect(placeFromOutside(TREE.index, FRONT, onScreen(-20, 0, -50), 1)?.branchId).toBe(1);
    // The thin branch is behind the end of the left branch, and visible only beyond that end.
    expect(placeFromOutside(TREE.index, FRONT, onScreen(39, 0, -60), 1)?.branchId).toBe(2);
    const { column, row } = onScreen(40, 30, -58);
    expect(placeFromOutside(TREE.index, FRONT, { column: column - 4, row: row - 12 }, 1)?.branchId).not.toBeNull();
    expect(placeFromOutside(TREE.index, FRONT, { column: 20, row: 20 }, 1)).toBeNull();
  });

  it("In the airway view it is the branch whose opening is under the cursor, else the branch of the tip.", () => {
    const down: SeenGeometry = {
      ...FRONT,
      camera: { right: [1, 0, 0], down: [0, 1, 0], forward: [0, 0, -1], position: [0, 0, -15] },
    };
    expect(branchAhead(TREE, 0, down, { column: 130, row: 200 })).toBe(1);
    expect(branchAhead(TREE, 0, down, { column: 270, row: 200 })).toBe(2);
    expect(branchAhead(TREE, 0, down, { column: 200, row: 20 })).toBe(0);
    expect(branchAhead(TREE, 99, down, { column: 200, row: 20 })).toBeNull();
  });
});

describe("descendants of a branch", () => {
  it("below returns the branch and all its descendants.", () => {
    const ids = (id: number) => {
      const node = TREE.byId.get(id);
      return node === undefined ? [] : below(node).map((member) => member.branch.id);
    };
    expect(ids(2)).toEqual([2, 3]);
    expect(new Set(ids(0))).toEqual(new Set([0, 1, 2, 3]));
  });

  it("pointsFrom returns the points from the given position to the branch's end.", () => {
    const trunk = TREE.root;
    const rest = pointsFrom(trunk, 33);
    expect(rest[0]?.[2]).toBeCloseTo(-33);
    expect(rest.at(-1)).toEqual([0, 0, -40]);
    expect(pointsFrom(trunk, 0)).toHaveLength(21);
    expect(pointsFrom(trunk, 999)).toEqual([[0, 0, -40]]);
  });
});

describe("forkOf", () => {
  it("returns the branch that ends at the nearer fork, or the branch's own fork if there is no other", () => {
    expect(forkOf(TREE, 2, 2)).toBe(0);
    expect(forkOf(TREE, 2, 40)).toBe(2);
    expect(forkOf(TREE, 1, 40)).toBe(0);
    expect(forkOf(TREE, 0, 1)).toBe(0);
  });
});
