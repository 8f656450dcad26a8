/** Path to the cursor: its requests, the valid answer, and the text beside the cursor. */

import type { AskLivePathMessage, LivePathMessage } from "../wire/messages";
import { fixed, mm, sentence } from "./format";
import { type Answered, LatestRequestQueue } from "./latest-request-queue";
import { endText } from "./route";

/** Point of a path request: a patient point, or a pixel of an airway picture. */
export type LiveQuestion = Pick<AskLivePathMessage, "lps" | "frame_id" | "column" | "row">;

/** Answer to a path request with its response time. */
export type LiveAnswer = Answered<LivePathMessage>;

/** Queue of the requests for the path to the cursor. */
export class LivePathQueue extends LatestRequestQueue<LiveQuestion, LivePathMessage> {
  constructor(send: (message: AskLivePathMessage) => boolean, nowMs: () => number) {
    super((id, question) => send({ type: "live_path", request_id: id, ...question }), nowMs);
  }
}

/** Length, mm, below which a new part of a path, or a shift of its end, counts as rounding. */
const SMALL_MM = 0.3;

/** Return the text lines about a path beside the cursor; `warns` is true if there is no path. */
export function livePathLines(answer: LivePathMessage): { lines: readonly string[]; warns: boolean } {
  if (answer.problem !== null || answer.length_mm === null) {
    return { lines: [firstSentences(sentence(answer.problem ?? "no path to this point"))], warns: true };
  }
  const lines = [endText({ length_mm: answer.length_mm, from_carina_mm: answer.from_carina_mm })];
  if (answer.min_diameter_mm !== null) lines.push(`fits up to ${mm(answer.min_diameter_mm)}`);
  if (answer.confidence !== null) lines.push(`${fixed(100 * answer.confidence)} % confidence`);
  if (answer.new_mm !== null && answer.new_mm > SMALL_MM) lines.push(`${mm(answer.new_mm)} beyond the tree`);
  if (answer.snapped_mm !== null && answer.snapped_mm > SMALL_MM) {
    lines.push(`moved ${mm(answer.snapped_mm)} into the lumen`);
  }
  return { lines, warns: false };
}

/** Number of characters to which the text beside the cursor is shortened. */
const MAX_CHARS = 90;

/** Return as many whole sentences of a text as fit beside the cursor, at least one. */
export function firstSentences(text: string): string {
  const [first = "", ...more] = text.match(/[^.]+(?:\.\d+[^.]*)*\.?\s*/g) ?? [text];
  let cut = first;
  for (const next of more) {
    if (cut.length + next.trimEnd().length > MAX_CHARS) break;
    cut += next;
  }
  return cut.trimEnd();
}

/**
 * Return the index of the path point at which the path leaves the tree; the last `newMm` of the path are outside the
 * tree.
 */
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
