/** The lasting notes of the case and its airways. */

import type { CaseNote } from "../wire/messages";

/** Those beside "not HU", which has a badge and words of its own. */
export function besideNotHu(badges: readonly CaseNote[]): readonly CaseNote[] {
  return badges.filter(({ code }) => code !== "import.not-hu");
}

/** What the step Check lists: doubts first, nothing twice. */
export function findingsOf(
  badges: readonly CaseNote[],
  quality: readonly string[],
  warnings: readonly string[],
): readonly string[] {
  return [...new Set([...besideNotHu(badges).map(({ words }) => words), ...quality, ...warnings])];
}
