/** Texts of the question about an imported mask, which the server asks before it uses the mask. */

import type { MaskLabel, MaskQuestion } from "../wire/messages";
import { plural } from "./format";

/** Return a volume as text, `61 ml`, with enough digits to tell a bronchus from a lung. */
export function volumeText(ml: number): string {
  const THIN = "\u202f";
  if (ml > 0 && ml < 0.1) return `under 0.1${THIN}ml`;
  return `${ml >= 10 ? Math.round(ml).toLocaleString("en-US") : ml.toFixed(1)}${THIN}ml`;
}

/** Return the title of a label, `2  Airway tree`, or its number if the file has no name. */
export const labelTitle = (label: MaskLabel): string => label.name ?? `Label ${label.number}`;

/** Return the number of the label that is selected initially: the server's suggestion, or null. */
export const firstChoice = (question: MaskQuestion): number | null => question.suggested;

/** Return the title of the question about a mask. */
export function questionTitle(question: MaskQuestion): string {
  return question.problem === "label"
    ? `Which one is the airway lumen?`
    : `The segmentation is on a different grid from the scan`;
}

/** Return the text of the question about a mask. */
export function questionText(question: MaskQuestion): string {
  return question.problem === "label"
    ? `${question.title} contains ${plural(question.labels.length, "structure")}.`
    : `${question.title} is on a different grid from this scan.`;
}

/** Return a warning with the share of the mask outside the scan; null if the share is only rounding. */
export function lostText(question: MaskQuestion): string | null {
  const share = question.share_inside;
  if (share === null || share >= 0.995) return null;
  const percent = Math.min(99, Math.max(1, Math.round(100 * (1 - share))));
  return `${percent} % of it lies outside this scan and would be cut off. Does it belong to this patient and this scan?`;
}
