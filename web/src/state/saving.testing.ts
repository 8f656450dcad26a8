/** Saved state of a new case, for tests. */

import type { SavingInfo } from "../wire/messages";

/** Saved state of a case of which nothing has been saved. */
export const NOTHING_SAVED: SavingInfo = {
  keeps: true,
  saved_s: null,
  begun_s: null,
  problem: null,
  copied_s: null,
  copy_name: null,
  copy_folder: null,
  copy_problem: null,
  copy_conflict: null,
  beside: null,
  suggested: null,
  title: null,
  continued_s: null,
  continued_changes: 0,
};
