/** The named file of the open case: its path, and the user's choices after another process has changed the file. */

import type { SavingInfo } from "../wire/messages";

/** Choices that the user has after another process has changed the named file. */
export interface ConflictChoices {
  /** Free path that "Save as a new file" would write; null without a conflict. */
  readonly beside: string | null;
  /** Whether the changed file contains a case that can be opened. */
  readonly opens: boolean;
  /** Whether the changed file may be replaced; false while another window has it open. */
  readonly replaces: boolean;
}

/** Return the path of the named file; null if the case has none. */
export function namedPath(saving: SavingInfo): string | null {
  return saving.copy_name === null ? null : `${saving.copy_folder ?? ""}/${saving.copy_name}`;
}

/** Return the choices that the user has after a conflict with the named file. */
export function conflictChoices(saving: SavingInfo): ConflictChoices {
  const kind = saving.copy_conflict;
  return {
    beside: kind === null ? null : saving.beside,
    opens: kind === "changed" || kind === "other-case",
    replaces: kind !== null && kind !== "open-elsewhere",
  };
}
