/** Marks that precede the outcomes of verdicts. */

/** Mark of each outcome: tick, question mark, cross, and dash. */
export const OUTCOME_MARKS: Readonly<Record<string, string>> = {
  reaches: "\u2713",
  "may reach": "?",
  "does not reach": "\u2717",
  "cannot say": "\u2013",
};
