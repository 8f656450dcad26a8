/** What makes it another case. The one rule for it: whoever forgets what belonged to a case asks here. */

import type { StateMessage } from "../wire/messages";

/** Tells one open case from another, "" for none; two may be of one CT, one after the other. */
export function caseKey(session: StateMessage | null): string {
  const open = session?.case ?? null;
  return open === null ? "" : JSON.stringify([open.number, open.title, open.shape_zyx, open.lps_from_ijk]);
}
