/** Texts about the cluster computers that render together with this one. */

import type { ClusterMessage, MemberStatus } from "../wire/messages";
import { plural } from "./format";

/** Return the number of machines of the cluster that render, as text. */
export function clusterText(cluster: ClusterMessage): string {
  const ready = cluster.members.filter((member) => member.state === "ready").length;
  const all = cluster.members.length;
  const mixed = cluster.mixed ? ", mixed" : "";
  if (cluster.alone) return `cluster: this machine only${mixed}`;
  return `cluster: ${ready === all ? plural(all, "machine") : `${ready} of ${plural(all, "machine")}`}${mixed}`;
}

/** Return the current activity of a cluster computer as text. */
export function memberText(member: MemberStatus): string {
  switch (member.state) {
    case "ready":
      return "rendering";
    case "late":
      return "late: other machines are rendering its share";
    case "away":
      return "not responding";
    case "loading":
      return "receiving the scan";
  }
}

/** Return whether the status of the cluster needs the user's attention. */
export function needsLook(cluster: ClusterMessage): boolean {
  return cluster.alone || cluster.members.some((member) => member.state === "late" || member.state === "away");
}
