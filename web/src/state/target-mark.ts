/** What a click with the tool *Mark target* would mark: its requests, the valid answer, and the text at the cursor. */

import type { TargetMarkMessage } from "../wire/messages";
import type { AppState } from "./app-state";
import { fixed, sentence } from "./format";
import { livePathLines } from "./live-path";
import { distance, type Vec3 } from "./vec";

/** Time, ms, for which the cursor rests before the structure under the cursor is segmented. */
export const RESTS_MS = 250;
/** Maximum distance, mm, between the cursor and the point of an answer at which the answer is shown. */
const SAME_POINT_MM = 0.3;

/** Return whether a click would segment the structure at the point, so that the cursor states the result. */
export const marksStructure = (state: Pick<AppState, "ui" | "session">): boolean =>
  state.ui.armed === "target" && state.ui.pathCost === "lumen" && state.session?.case?.is_hu === true;

/** Return whether an answer is for the point under the cursor. */
export const isMarkAt = (mark: TargetMarkMessage | null, lps: Vec3 | null): boolean =>
  mark !== null && lps !== null && distance(mark.lps as unknown as Vec3, lps) < SAME_POINT_MM;

/**
 * Return the text at the cursor while a click would segment the structure there: what the click marks, and the path
 * through the airways if one leads there. The answer is valid only for the point under the cursor.
 */
export function targetMarkLines(
  state: Pick<AppState, "targetMark" | "livePath" | "probed" | "ui">,
): { lines: readonly string[]; warns: boolean } | null {
  const { targetMark, livePath, probed, ui } = state;
  const path = livePath === null || livePath.answer.problem !== null ? null : livePathLines(livePath.answer);
  const mark = isMarkAt(targetMark, ui.pointedLps) ? targetMark : null;
  if (mark !== null && mark.sentences.length > 0) {
    // A path is of use only if the click marks the airway.
    const ofPath = mark.warns || mark.sentences[0]?.includes("nodule") === true ? [] : (path?.lines ?? []);
    return { lines: [...mark.sentences.map(sentence), ...ofPath], warns: mark.warns };
  }
  if (path !== null) return path;
  if (livePath === null) return null;
  const value = probed?.voxel_value ?? null;
  const here = value === null ? "what is here" : `what is here (${fixed(value)} HU)`;
  return { lines: [`A click measures ${here}.`, "Rest the cursor to see the result first."], warns: false };
}
