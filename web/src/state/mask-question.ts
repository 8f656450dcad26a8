/** What is asked about a mask of another tool, in words. */

import type { MaskLabel, MaskQuestion } from "../wire/messages";
import { plural } from "./format";

/** `61 ml`, with as many digits as help to tell a bronchus from a lung. */
export function volumeWords(ml: number): string {
  const THIN = "\u202f";
  if (ml > 0 && ml < 0.1) return `under 0.1${THIN}ml`;
  return `${ml >= 10 ? Math.round(ml).toLocaleString("en-US") : ml.toFixed(1)}${THIN}ml`;
}

/** `2  Airway tree`, or the number alone where the file has no name for it. */
export const labelTitle = (label: MaskLabel): string => label.name ?? `Label ${label.number}`;

/** The structure that is marked at first: the one that is called so, or none. */
export const firstChoice = (question: MaskQuestion): number | null => question.suggested;

export function questionTitle(question: MaskQuestion): string {
  return question.problem === "label"
    ? `Which one is the airway lumen?`
    : `The segmentation is on a different grid from the scan`;
}

export function questionWords(question: MaskQuestion): string {
  return question.problem === "label"
    ? `${question.title} contains ${plural(question.labels.length, "structure")}.`
    : `${question.title} is on a different grid from this scan.`;
}

/** A warning where much of the mask would be lost; null where all but rounding lies in the scan. */
export function lostWords(question: MaskQuestion): string | null {
  const share = question.share_inside;
  if (share === null || share >= 0.995) return null;
  const percent = Math.min(99, Math.max(1, Math.round(100 * (1 - share))));
  return `${percent} % of it lies outside this scan and would be cut off. Does it belong to this patient and this scan?`;
}
