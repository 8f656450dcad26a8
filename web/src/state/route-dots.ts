/** Dots of the planned route at the next turn: those of the list of turns, which are inside the opening to enter. */

import type { PlannedTurn, RouteInfo } from "../wire/messages";
import { asVec3, type Vec3 } from "./vec";

/** Distance, mm, of the tip past a fork up to which the dots that mark the fork's opening are drawn. */
const STILL_HERE_MM = 4;

/** The next turn of a route with an opening in view. */
export interface NextTurn {
  /** Position of the fork along the route, mm. */
  forkMm: number;
  /** Points inside the opening, from near to far; empty if the CT does not show the branch. */
  dots: Vec3[];
}

/** Return the next turn of a route at or ahead of a position; null if the list of turns has none with an opening in view. */
export function nextTurn(
  route: Pick<RouteInfo, "spans">,
  turns: readonly PlannedTurn[],
  fromMm: number,
): NextTurn | null {
  for (const turn of turns) {
    const before = route.spans.find((span) => span.branch_id === turn.fork_branch_id);
    const into = route.spans.find((span) => span.branch_id === turn.openings[0]?.branch_id);
    if (before === undefined || into === undefined || before.to_mm < fromMm - STILL_HERE_MM) continue;
    if (turn.dots_lps.length === 0) return null;
    return { forkMm: before.to_mm, dots: into.kind === "tracked" ? turn.dots_lps.map((dot) => asVec3(dot)) : [] };
  }
  return null;
}
