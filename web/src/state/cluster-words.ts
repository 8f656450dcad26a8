/** How the machines do that render with this one, in words. */

import type { ClusterMessage, MemberStatus } from "../wire/messages";
import { plural } from "./format";

/** The few words of the status bar. */
export function clusterWords(cluster: ClusterMessage): string {
  const ready = cluster.members.filter((member) => member.state === "ready").length;
  const all = cluster.members.length;
  const mixed = cluster.mixed ? ", mixed" : "";
  if (cluster.alone) return `cluster: this machine only${mixed}`;
  return `cluster: ${ready === all ? plural(all, "machine") : `${ready} of ${plural(all, "machine")}`}${mixed}`;
}

/** What a machine does now. */
export function memberWords(member: MemberStatus): string {
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

/** Whether a person should look. */
export function needsLook(cluster: ClusterMessage): boolean {
  return cluster.alone || cluster.members.some((member) => member.state === "late" || member.state === "away");
}
