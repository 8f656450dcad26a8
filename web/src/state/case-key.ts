/** Key that identifies the open case. All code that discards state when the case changes uses this key. */

import type { StateMessage } from "../wire/messages";

/** Return a key that distinguishes open cases, "" for none; two successive cases of the same CT have different keys. */
export function caseKey(session: StateMessage | null): string {
  const open = session?.case ?? null;
  return open === null ? "" : JSON.stringify([open.number, open.title, open.shape_zyx, open.lps_from_ijk]);
}
