/** Arrow of a task with the hint `arrow`: the direction of the next turn to the next step, as picture and as text. */

import type { PoseMessage } from "../wire/messages";
import { type BranchTree, lineage, openingDirection } from "./airways";
import type { Camera } from "./vec";

/** Angle between the opening and the middle of the picture, degrees, below which the way is straight ahead. */
const AHEAD_DEG = 8;

/** Direction of the next turn. */
export type TaskArrow =
  /** Withdraw: the tip is in a branch that does not lead to the step. */
  | { readonly kind: "back" }
  /** The opening of the next branch is in the middle of the picture, or the tip is in the branch of the step. */
  | { readonly kind: "ahead" }
  /** The opening of the next branch is at this clock hour. */
  | { readonly kind: "turn"; readonly hour: number };

/**
 * Return the direction of the next turn to one of the branches of a step; null without a step, or outside the airways.
 * Of several branches, the one with the fewest branches to withdraw through is chosen, then the first one.
 */
export function taskArrow(
  tree: BranchTree | null,
  { branch_id: at }: Pick<PoseMessage, "branch_id">,
  camera: Camera,
  goals: readonly number[],
): TaskArrow | null {
  if (tree === null || at === null || goals.length === 0) return null;
  const here = lineage(tree, at).map(({ branch }) => branch.id);
  const ways = goals.map((goal) => lineage(tree, goal).map(({ branch }) => branch.id));
  const shared = (way: readonly number[]): number => way.filter((id) => here.includes(id)).length;
  const best = ways.reduce<readonly number[]>((a, b) => (shared(b) > shared(a) ? b : a), ways[0] ?? []);
  const goal = best.at(-1);
  if (goal === undefined) return null;
  if (here.includes(goal)) return { kind: "ahead" };
  if (!best.includes(at)) return { kind: "back" };
  const next = tree.byId.get(best[best.indexOf(at) + 1] ?? -1);
  const node = tree.byId.get(at);
  if (next === undefined || node === undefined) return null;
  const seen = openingDirection(node, next, camera);
  if (seen === null || seen.offDeg < AHEAD_DEG) return { kind: "ahead" };
  return { kind: "turn", hour: seen.hour };
}

/** Return the direction as text for the trainee. */
export function arrowText(arrow: TaskArrow): string {
  switch (arrow.kind) {
    case "back":
      return "Withdraw";
    case "ahead":
      return "Straight ahead";
    case "turn":
      return `Turn to ${arrow.hour} o\u2019clock`;
  }
}
