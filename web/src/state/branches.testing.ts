/** Branches for tests, for which a test states only the position in the tree and the fields that matter. */

import type { TreeBranch } from "../wire/messages";

/** Return a branch with default values for the fields that `change` does not set. */
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
