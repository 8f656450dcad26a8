/** Constants and functions of the workstation that need no state. */

import type { StreamStatus } from "../net/stream";
import type { Connection } from "../state/app-state";

/** Slab thicknesses and projections that the slab key cycles through. */
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
  // The browser has read the file after one second, so its memory can be released.
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

/** Convert the status of the stream to the connection status of the state. */
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
