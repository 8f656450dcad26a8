/** Functions of the workstation without state. */

import type { StreamStatus } from "../net/stream";
import type { Connection } from "../state/app-state";

/** Slab thicknesses that the key cycles through. */
export const SLABS = [
  { thickness_mm: 0, kind: "min" },
  { thickness_mm: 10, kind: "min" },
  { thickness_mm: 10, kind: "max" },
  { thickness_mm: 5, kind: "mean" },
] as const;

/** Save a file through the browser's download. */
export function saveAs(name: string, blob: Blob): void {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  // The browser has read the file by then, so its memory can be released.
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

/** Return the connection status for the state. */
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
