/** Notes about the quality of the case and its airways. */

import type { CaseNote } from "../wire/messages";

/** Return the notes except "not HU", which has its own badge and text. */
export function besideNotHu(badges: readonly CaseNote[]): readonly CaseNote[] {
  return badges.filter(({ code }) => code !== "import.not-hu");
}

/** Return the findings of the Check step: doubts first, without duplicates. */
export function findingsOf(
  badges: readonly CaseNote[],
  quality: readonly string[],
  warnings: readonly string[],
): readonly string[] {
  return [...new Set([...besideNotHu(badges).map(({ words }) => words), ...quality, ...warnings])];
}
