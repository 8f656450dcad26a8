/** The words of a case in the list, and of what the cases take on the disk. */

import type { RecentCase, SavingInfo } from "../wire/messages";
import { clock, plural } from "./format";

/** So many stand on the start page; all are under *Cases and storage*. */
export const RECENT_SHOWN = 5;
/** A forgotten case is there so long. */
export const FORGOTTEN_FOR = "24 hours";

const KILO = 1000;
const UNITS = ["kB", "MB", "GB", "TB"] as const;

/** `1.8 MB`; less than a kilobyte is one. */
export function sizeWords(bytes: number): string {
  if (bytes <= 0) return "0\u202fMB";
  let value = Math.max(bytes / KILO, 1);
  let unit = 0;
  while (Math.round(value) >= KILO && unit < UNITS.length - 1) {
    value /= KILO;
    unit += 1;
  }
  return `${value < 10 && unit > 0 ? value.toFixed(1) : Math.round(value)}\u202f${UNITS[unit]}`;
}

export const changesWords = (count: number): string => (count === 0 ? "no changes" : plural(count, "change"));

/** `scan of 3 May 2021`. The day is a day, not a moment: no time zone moves it. */
export function scanWords(isoDate: string): string {
  const day = new Date(`${isoDate}T00:00:00Z`);
  const format = { day: "numeric", month: "long", year: "numeric", timeZone: "UTC" } as const;
  return `scan of ${day.toLocaleDateString("en-GB", format)}`;
}

/** What tells one case from another: scan date, changes, last use, and a short code where another has its title. */
export function caseFacts(entry: RecentCase, all: readonly RecentCase[], nowMs: number): string[] {
  const facts = entry.scanned_on === null ? [] : [scanWords(entry.scanned_on)];
  if (entry.num_changes !== null) facts.push(changesWords(entry.num_changes));
  facts.push(`last used ${entry.used_s === null ? entry.date.slice(0, 10) : clock(entry.used_s, nowMs)}`);
  if (all.some(({ recent_id, title }) => recent_id !== entry.recent_id && title === entry.title))
    facts.push(`case ${entry.recent_id.slice(0, 4)}`);
  return facts;
}

/** Null where the case is new, was not changed before, has been changed since, or these words have been read. */
export function continuedWords(
  saving: SavingInfo | null,
  numChanges: number,
  readS: number | null,
  nowMs: number,
): string | null {
  if (saving === null || saving.continued_s === null || saving.continued_changes === 0) return null;
  if (saving.continued_s === readS || numChanges !== saving.continued_changes) return null;
  return `Continued from ${clock(saving.continued_s, nowMs)}, ${changesWords(saving.continued_changes)}.`;
}
