/** The fork ahead of the tip: its distance, and the branches that continue from it as the airway view shows them. */

import type { PlannedTurn, RouteInfo } from "../wire/messages";
import { type BranchTree, type OnwardBranch, onwardBranches, type TurnBranches } from "./airways";
import { FORK_TOLERANCE_MM } from "./route";
import type { Camera } from "./vec";

/** Distance, mm, of the tip past a fork up to which the airway view still describes that fork. */
const STILL_HERE_MM = 4;

/**
 * Maximum distance of the tip from a fork, mm, at which clock hours are shown; from farther away all openings look
 * central.
 */
const HOURS_MM = 30;

/** The fork ahead of the tip on the route. */
export interface ForkAhead {
  /** Distance from the tip to the fork, mm; 0 at the fork or past it. */
  distanceMm: number;
  /** Whether the tip is near enough to the fork for clock hours to be shown. */
  near: boolean;
  ways: OnwardBranch[];
}

/** Return the fork ahead of the tip; null if no fork of the tree is ahead on the route. */
export function forkAhead(
  tree: BranchTree,
  route: RouteInfo,
  pathMm: number,
  camera: Camera,
  /**
   * ID of the branch that ends at the fork of a listed turn, while the tip is at the viewpoint of that turn; null
   * selects the next fork.
   */
  forkBranchId: number | null = null,
  /** List of turns of the route, which gives the openings of its forks. */
  turns: readonly PlannedTurn[] = [],
): ForkAhead | null {
  // At the viewpoint of a fork that fork is selected, even if the previous fork is still near.
  const lookoutMm = route.lookouts_mm.findLast((at) => at <= pathMm + FORK_TOLERANCE_MM) ?? 0;
  const fromMm = Math.max(pathMm - STILL_HERE_MM, lookoutMm);
  for (const span of route.spans) {
    if (forkBranchId === null ? span.to_mm < fromMm : span.branch_id !== forkBranchId) continue;
    const node = tree.byId.get(span.branch_id);
    if (node === undefined || node.children.length < 2) continue;
    const distanceMm = span.to_mm - pathMm;
    return {
      distanceMm: distanceMm < FORK_TOLERANCE_MM ? 0 : distanceMm,
      near: distanceMm <= HOURS_MM,
      ways: onwardBranches(node, camera, route, turnBranchesOf(tree, turns, span.branch_id, forkBranchId !== null)),
    };
  }
  return null;
}

/** Return the listed openings of the fork at the end of a branch; null if the fork is not in the list of turns. */
function turnBranchesOf(
  tree: BranchTree,
  turns: readonly PlannedTurn[],
  branchId: number,
  atViewpoint: boolean,
): TurnBranches | null {
  const turn = turns.find((one) => one.fork_branch_id === branchId);
  if (turn === undefined || turn.openings.length === 0) return null;
  const ways = turn.openings.flatMap((opening) => {
    const node = tree.byId.get(opening.branch_id);
    return node === undefined ? [] : [{ node, opening }];
  });
  return ways.length === turn.openings.length ? { ways, doubtful: turn.hour_doubt !== null, atViewpoint } : null;
}
