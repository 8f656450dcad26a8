/** Notes about the quality of the case and its airways. */

import type { CaseNote, CtStatement } from "../wire/messages";

/** Return whether a note states that a nodule was inserted into the CT. */
export function isInserted({ code }: CaseNote): boolean {
  return code === "import.inserted";
}

/** Return the notes except "not HU", which has a separate badge and text. */
export function withoutHuNote(badges: readonly CaseNote[]): readonly CaseNote[] {
  return badges.filter(({ code }) => code !== "import.not-hu");
}

/** Return the findings of the quality gate that the statement on the CT does not contain. */
export function notInStatement(quality: readonly string[], statement: CtStatement | null): readonly string[] {
  if (statement === null) return quality;
  return quality.filter((finding) => !statement.properties.some(({ text }) => text.includes(finding)));
}

/** Return the texts of the Check step: doubts about the case and the airways first, without duplicates. */
export function findingsOf(
  badges: readonly CaseNote[],
  quality: readonly string[],
  warnings: readonly string[],
): readonly string[] {
  return [...new Set([...withoutHuNote(badges).map(({ words }) => words), ...quality, ...warnings])];
}
