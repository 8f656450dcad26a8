/** Texts of the top bar about the saved state of the case. */

import type { SavingInfo } from "../wire/messages";
import { clock } from "./format";

/** A text about the saved state, with its tooltip. */
export interface SavedText {
  readonly label: string;
  /** Tooltip of the text on the saving of the case. */
  readonly words: string;
  readonly warns: boolean;
}

/** Return the text about the saved state of the case; null while no case is open. */
export function savedText(saving: SavingInfo | null, nowMs: number): SavedText | null {
  if (saving === null) return null;
  if (!saving.keeps) {
    return {
      label: "not saved",
      words:
        "This case was not opened from a folder or file on this machine, so it is not saved. Its airways and key frames can be downloaded under Share.",
      warns: true,
    };
  }
  if (saving.problem !== null) {
    if (saving.copied_s !== null && saving.copied_s > (saving.saved_s ?? 0)) {
      const copied = `copy from ${clock(saving.copied_s, nowMs)} in ${folderOf(saving)}`;
      return { label: `cannot save on this machine \u00b7 ${copied}`, words: saving.problem, warns: true };
    }
    const last = saving.saved_s === null ? "nothing saved yet" : `last saved ${clock(saving.saved_s, nowMs)}`;
    return { label: `cannot save: ${last}`, words: saving.problem, warns: true };
  }
  if (saving.saved_s === null)
    return { label: "not changed", words: "Changes are saved as you make them.", warns: false };
  const saved = `saved ${clock(saving.saved_s, nowMs)}`;
  if (saving.copy_name === null || saving.copied_s === null) {
    return {
      label: saved,
      words: "Saved on this machine as you work. Save a copy under a name you choose.",
      warns: false,
    };
  }
  if (saving.copy_conflict !== null) {
    return {
      label: `${saved}, not in ${saving.copy_name}`,
      words: saving.copy_problem ?? "",
      warns: true,
    };
  }
  if (saving.copy_problem !== null) {
    return {
      label: `${saved}, copy from ${clock(saving.copied_s, nowMs)} is out of date`,
      words: saving.copy_problem,
      warns: true,
    };
  }
  return {
    label: `${saved} \u00b7 copy from ${clock(saving.copied_s, nowMs)} in ${folderOf(saving)}`,
    words: `${saving.copy_folder ?? ""}: ${saving.copy_name}. It is updated every minute and when the case is closed.`,
    warns: false,
  };
}

function folderOf(saving: SavingInfo): string {
  return (saving.copy_folder ?? "").split(/[/\\]/).at(-1) ?? "";
}
