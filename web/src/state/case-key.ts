/** What makes it another case. The one rule for it: whoever forgets what belonged to a case asks here. */

import type { StateMessage } from "../wire/messages";

/** Tells one open case from another, "" for none; reopening the same one changes nothing on the screen. */
export function caseKey(session: StateMessage | null): string {
  const open = session?.case ?? null;
  return open === null ? "" : JSON.stringify([open.title, open.shape_zyx, open.lps_from_ijk]);
}
