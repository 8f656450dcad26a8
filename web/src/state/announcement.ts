/** Text for screen readers about the fork ahead, a wrong branch and the end of the route. */

import type { ForkAhead } from "./fork";
import { mm } from "./format";

/** Information about the path ahead of the tip that the airway view shows. */
export interface WayAhead {
  readonly fork: ForkAhead | null;
  readonly atEnd: boolean;
  readonly wrong: { readonly branch: string; readonly back: string } | null;
}

/** An announcement; its text is read once for each key, although the distance changes with every movement. */
export interface Announcement {
  readonly key: string;
  readonly text: string;
}

/** Return the announcement for the way ahead; null if there is nothing to announce. */
export function announcementOf({ fork, atEnd, wrong }: WayAhead): Announcement | null {
  if (wrong !== null) {
    return { key: `wrong ${wrong.branch}`, text: `Wrong branch: you are in ${wrong.branch}. Go back ${wrong.back}.` };
  }
  if (atEnd) return { key: "end", text: "End of the route." };
  if (fork === null || !fork.near || fork.ways.length === 0) return null;
  const ways = fork.ways.map(({ node, hour, noHour, chosen }) => {
    const direction = hour === null ? (noHour ?? "straight ahead") : `${hour} o\u2019clock`;
    return `${node.label}, ${direction}${chosen ? ", your route" : ""}`;
  });
  const where = fork.distanceMm <= 0 ? "At the fork" : `Fork in ${mm(fork.distanceMm, 0)}`;
  return { key: fork.ways.map(({ node }) => node.branch.id).join(" "), text: `${where}: ${ways.join("; ")}.` };
}
