/** What the workstation does without remembering anything. */

import type { StreamStatus } from "../net/stream";
import type { Connection } from "../state/app-state";

/** What the key for the slab goes through. */
export const SLABS = [
  { thickness_mm: 0, kind: "min" },
  { thickness_mm: 10, kind: "min" },
  { thickness_mm: 10, kind: "max" },
  { thickness_mm: 5, kind: "mean" },
] as const;

/** Hands a file to the browser, as a click on a link would. */
export function saveAs(name: string, blob: Blob): void {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  // The browser has taken the file by the next turn.
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

export function asConnection(status: StreamStatus): Connection {
  switch (status.status) {
    case "connecting":
    case "open":
      return { status: status.status, reason: null, retryAtMs: null };
    case "lost":
      return { status: "lost", reason: status.reason, retryAtMs: status.retryAtMs };
    case "refused":
      return { status: "refused", reason: status.reason, retryAtMs: null };
  }
}
