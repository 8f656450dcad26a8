/** Selection of the fork that the fork tool moves. */

import type { BranchTree } from "./airways";

/**
 * Return the ID of the branch that ends at the fork nearest to a position: the branch itself, or its parent. Null if
 * neither ends at a fork.
 */
export function forkOf(tree: BranchTree, branchId: number, alongMm: number): number | null {
  const node = tree.byId.get(branchId);
  if (node === undefined) return null;
  const own = node.children.length > 0 ? node.branch.id : null;
  const before = node.branch.parent;
  if (own === null || before === null) return own ?? before;
  return alongMm < node.lengthMm / 2 ? before : own;
}
