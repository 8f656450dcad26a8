/** The fork ahead: how far, and the ways on from it as the picture shows them. */

import type { RouteInfo } from "../wire/messages";
import { type BranchTree, type WayOn, waysOn } from "./airways";
import { FORK_TOLERANCE_MM } from "./route";
import type { Camera } from "./vec";

/** A fork that was just passed is still the one in front of the eye. */
const STILL_HERE_MM = 4;

/** From farther away all openings lie in the middle of the picture, and their hours say nothing. */
const HOURS_MM = 30;

export interface ForkAhead {
  /** From the tip; 0 at the fork. */
  distanceMm: number;
  /** Near enough for the ways' hours to be told. */
  near: boolean;
  ways: WayOn[];
}

/** Null where the route has no fork ahead with more than one way on. */
export function forkAhead(
  tree: BranchTree,
  route: RouteInfo,
  pathMm: number,
  camera: Camera,
  /** The branch that ends in the fork that is meant, where the tip stands before one of the list of turns. */
  meant: number | null = null,
): ForkAhead | null {
  // At a look-out the fork that it was made for is meant, however near the one behind still is.
  const lookoutMm = route.lookouts_mm.findLast((at) => at <= pathMm + FORK_TOLERANCE_MM) ?? 0;
  const fromMm = Math.max(pathMm - STILL_HERE_MM, lookoutMm);
  for (const span of route.spans) {
    if (meant === null ? span.to_mm < fromMm : span.branch_id !== meant) continue;
    const node = tree.byId.get(span.branch_id);
    if (node === undefined || node.children.length < 2) continue;
    const distanceMm = span.to_mm - pathMm;
    return {
      distanceMm: distanceMm < FORK_TOLERANCE_MM ? 0 : distanceMm,
      near: distanceMm <= HOURS_MM,
      ways: waysOn(node, camera, route),
    };
  }
  return null;
}
