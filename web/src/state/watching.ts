/** What a window may do that only watches, and what is said of those who do. */

import { type ClientMessage, SETS, type WatchPage } from "../wire/messages";
import { plural } from "./format";

/** What the server answers a watcher: its own sight, and questions about what it sees. */
export function mayWatcherSend(message: ClientMessage): boolean {
  const { type } = message;
  if (type in SETS) return SETS[type as keyof typeof SETS].of === "sight";
  return type === "pick" || type === "probe" || type === "branch_detail";
}

/** For the top bar of the workstation that is watched. */
export function watchingWords(page: WatchPage): string {
  const num = page.watchers.length;
  return num === 0 ? "on the network" : `${plural(num, "person", "people")} watching`;
}
