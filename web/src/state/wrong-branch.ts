/** Text about a wrong branch in a rehearsal: where the tip is, and how far the scope must be withdrawn. */

import type { PoseMessage } from "../wire/messages";
import type { BranchTree } from "./airways";
import { mm } from "./format";

/** Return the text about the wrong branch that the tip is in; null on the route. */
export function wrongBranchText(
  pose: Pick<PoseMessage, "back_to_route_mm" | "branch_id" | "branch_name"> | null,
  tree: BranchTree | null,
): { branch: string; back: string } | null {
  if (pose === null || pose.back_to_route_mm === null) return null;
  const node = pose.branch_id === null ? undefined : tree?.byId.get(pose.branch_id);
  return { branch: pose.branch_name ?? node?.label ?? "another branch", back: mm(pose.back_to_route_mm, 0) };
}
