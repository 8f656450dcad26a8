/** Branches for tests, with only their position in the tree. */

import type { TreeBranch } from "../wire/messages";

/** Return a branch for tests. */
export function testBranch(
  id: number,
  parent: number | null,
  children: number[],
  change: Partial<TreeBranch> = {},
): TreeBranch {
  return {
    id,
    parent,
    children,
    generation: parent === null ? 0 : 1,
    name: null,
    kind: "tracked",
    points: [
      [0, 0, 0],
      [0, 0, -30],
    ],
    radius: [3, 3],
    cost: null,
    confidence: null,
    name_confidence: null,
    name_from: null,
    variant: null,
    doubtful_mm: 0,
    ...change,
  };
}
