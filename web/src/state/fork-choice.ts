/** Choice of the fork for a place on the tree. */

import type { BranchTree } from "./airways";

/**
 * Return the branch whose end is the nearest fork: the branch itself or its parent; null if the tree has no fork there.
 */
export function forkOf(tree: BranchTree, branchId: number, alongMm: number): number | null {
  const node = tree.byId.get(branchId);
  if (node === undefined) return null;
  const own = node.children.length > 0 ? node.branch.id : null;
  const before = node.branch.parent;
  if (own === null || before === null) return own ?? before;
  return alongMm < node.lengthMm / 2 ? before : own;
}
