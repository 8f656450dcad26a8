/** Rights of a window that only watches another workstation, and texts about watchers. */

import { type ClientMessage, SETS, type WatchPage } from "../wire/messages";
import { plural } from "./format";

/**
 * Return whether a watcher may send a message: settings of the watcher's views, and queries about the displayed data.
 */
export function mayWatcherSend(message: ClientMessage): boolean {
  const { type } = message;
  if (type in SETS) return SETS[type as keyof typeof SETS].of === "sight";
  return type === "pick" || type === "probe" || type === "branch_detail";
}

/** Return the text of the top bar about the watchers of this workstation. */
export function watchingText(page: WatchPage): string {
  const num = page.watchers.length;
  return num === 0 ? "on the network" : `${plural(num, "person", "people")} watching`;
}
