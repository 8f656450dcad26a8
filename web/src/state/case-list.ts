/** Texts about the recent cases and their disk usage. */

import type { RecentCase, SavingInfo } from "../wire/messages";
import { clock, plural } from "./format";

/** Number of cases on the start page; the dialog *Cases and storage* lists all. */
export const RECENT_SHOWN = 5;
/** Time for which the user can restore a forgotten case, as text. */
export const FORGOTTEN_FOR = "24 hours";

/** Factor between two units of file size, such as kB and MB. */
const KILO = 1000;
const UNITS = ["kB", "MB", "GB", "TB"] as const;

/** Return a file size as text, `1.8 MB`; a size of 1 to 999 bytes is written as one kilobyte. */
export function sizeText(bytes: number): string {
  if (bytes <= 0) return "0\u202fMB";
  let value = Math.max(bytes / KILO, 1);
  let unit = 0;
  while (Math.round(value) >= KILO && unit < UNITS.length - 1) {
    value /= KILO;
    unit += 1;
  }
  return `${value < 10 && unit > 0 ? value.toFixed(1) : Math.round(value)}\u202f${UNITS[unit]}`;
}

/** Return the number of changes as text. */
export const changesText = (count: number): string => (count === 0 ? "no changes" : plural(count, "change"));

/** Return the number of nodules as text; 0 as *no nodules*. */
export const nodulesText = (count: number): string => (count === 0 ? "no nodules" : plural(count, "nodule"));

/** Return the scan date as text, `scan of 3 May 2021`. The date has no time, so that no time zone shifts it. */
export function scanText(isoDate: string): string {
  const day = new Date(`${isoDate}T00:00:00Z`);
  const format = { day: "numeric", month: "long", year: "numeric", timeZone: "UTC" } as const;
  return `scan of ${day.toLocaleDateString("en-GB", format)}`;
}

/**
 * Return the facts that distinguish a case from others: scan date, number of nodules and of changes, last use, and a short code if
 * another case has the same title.
 */
export function caseFacts(entry: RecentCase, all: readonly RecentCase[], nowMs: number): string[] {
  const facts = entry.scanned_on === null ? [] : [scanText(entry.scanned_on)];
  if (entry.num_nodules !== null) facts.push(nodulesText(entry.num_nodules));
  if (entry.num_changes !== null) facts.push(changesText(entry.num_changes));
  facts.push(`last used ${entry.used_s === null ? entry.date.slice(0, 10) : clock(entry.used_s, nowMs)}`);
  if (all.some(({ recent_id, title }) => recent_id !== entry.recent_id && title === entry.title))
    facts.push(`case ${entry.recent_id.slice(0, 4)}`);
  return facts;
}

/**
 * Return the notice about a continued case; null if the case is new, was not changed before, has been changed since, or
 * the user has closed the notice.
 */
export function continuedText(
  saving: SavingInfo | null,
  numChanges: number,
  readS: number | null,
  nowMs: number,
): string | null {
  if (saving === null || saving.continued_s === null || saving.continued_changes === 0) return null;
  if (saving.continued_s === readS || numChanges !== saving.continued_changes) return null;
  return `Continued from ${clock(saving.continued_s, nowMs)}, ${changesText(saving.continued_changes)}.`;
}
