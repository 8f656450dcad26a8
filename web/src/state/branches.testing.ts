/** Branches for tests, with nothing known of them but where they are in the tree. */

import type { TreeBranch } from "../wire/messages";

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
