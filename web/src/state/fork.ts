/** The fork ahead: its distance, and the branches that continue from it as the airway view shows them. */

import type { RouteInfo } from "../wire/messages";
import { type BranchTree, type WayOn, waysOn } from "./airways";
import { FORK_TOLERANCE_MM } from "./route";
import type { Camera } from "./vec";

/** Distance, mm, behind the tip up to which a passed fork still counts as the fork ahead. */
const STILL_HERE_MM = 4;

/** Distance, mm, up to which clock hours are shown. From farther away all openings are in the middle of the view. */
const HOURS_MM = 30;

/** The fork ahead on the route. */
export interface ForkAhead {
  /** Distance from the tip, mm; 0 at the fork. */
  distanceMm: number;
  /** Whether the fork is near enough to show clock hours. */
  near: boolean;
  ways: WayOn[];
}

/** Return the fork ahead; null if the route has no fork ahead with more than one branch. */
export function forkAhead(
  tree: BranchTree,
  route: RouteInfo,
  pathMm: number,
  camera: Camera,
  /** Branch that ends at the selected fork, if the tip is at the viewpoint of a listed turn; null selects the next fork. */
  meant: number | null = null,
): ForkAhead | null {
  // At a look-out the fork of that look-out is selected, even if the previous fork is near.
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
