/** The way to the cursor: which answer counts, and what is said about it beside the cursor. */

import type { AskLivePathMessage, LivePathMessage } from "../wire/messages";
import { fixed, mm, sentence } from "./format";
import { type Answered, NewestAsker } from "./newest-asker";

/** What is asked for: a point, or a place in an airway picture. */
export type LiveQuestion = Pick<AskLivePathMessage, "lps" | "frame_id" | "column" | "row">;

export type LiveAnswer = Answered<LivePathMessage>;

/** Asks for the way to the cursor. */
export class LiveAsker extends NewestAsker<LiveQuestion, LivePathMessage> {
  constructor(send: (message: AskLivePathMessage) => boolean, nowMs: () => number) {
    super((id, question) => send({ type: "live_path", request_id: id, ...question }), nowMs);
  }
}

/** Shorter than this, a new part of a way or a shift of its end is rounding. */
const SMALL_MM = 0.3;

/** Lines beside the cursor; `warns` where there is no way. */
export function livePathLines(answer: LivePathMessage): { lines: readonly string[]; warns: boolean } {
  if (answer.problem !== null || answer.length_mm === null) {
    return { lines: [firstSentences(sentence(answer.problem ?? "no path to this point"))], warns: true };
  }
  const lines = [`${mm(answer.length_mm, 0)} from the tracheal entry`];
  if (answer.min_diameter_mm !== null) lines.push(`fits up to ${mm(answer.min_diameter_mm)}`);
  if (answer.confidence !== null) lines.push(`${fixed(100 * answer.confidence)} % confidence`);
  if (answer.new_mm !== null && answer.new_mm > SMALL_MM) lines.push(`${mm(answer.new_mm)} beyond the tree`);
  if (answer.snapped_mm !== null && answer.snapped_mm > SMALL_MM) {
    lines.push(`moved ${mm(answer.snapped_mm)} into the lumen`);
  }
  return { lines, warns: false };
}

/** At the cursor there is room for so much, in letters. */
const ROOM = 90;

/** As many whole sentences as there is room for, at least one. */
export function firstSentences(text: string): string {
  const [first = "", ...more] = text.match(/[^.]+(?:\.\d+[^.]*)*\.?\s*/g) ?? [text];
  let kept = first;
  for (const next of more) {
    if (kept.length + next.trimEnd().length > ROOM) break;
    kept += next;
  }
  return kept.trimEnd();
}

/** Index of the point where the way leaves the tree: what comes after is its last `newMm`. */
export function leavesTreeAt(points: LivePathMessage["points_lps"], newMm: number | null): number {
  if (newMm === null || newMm <= SMALL_MM) return points.length - 1;
  let left = newMm;
  for (let n = points.length - 1; n > 0; n -= 1) {
    const a = points[n - 1];
    const b = points[n];
    if (a === undefined || b === undefined) break;
    left -= Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
    if (left <= 0) return n - 1;
  }
  return 0;
}
