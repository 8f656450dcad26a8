/** The way to the cursor: which answer counts, and what is said about it beside the cursor. */

import type { AskLivePathMessage, LivePathMessage } from "../wire/messages";
import { fixed, mm, sentence } from "./format";

/** What is asked for: a point, or a place in an airway picture. */
export type LiveQuestion = Pick<AskLivePathMessage, "lps" | "frame_id" | "column" | "row">;

export interface LiveAnswer {
  readonly answer: LivePathMessage;
  /** From the question's sending to here. */
  readonly tookMs: number;
}

/** Where a server has not answered for so long, it is asked again. */
const LOST_MS = 2000;

/**
 * Asks the newest question only, and not before the last one was answered: a slow machine is not asked more than it can
 * answer, a fast one is asked at once.
 */
export class LiveAsker {
  readonly #send: (message: AskLivePathMessage) => boolean;
  readonly #nowMs: () => number;
  #nextId = 1;
  #underWay: { id: number; atMs: number } | null = null;
  #waiting: LiveQuestion | null = null;
  /** Answers up to this one are not wanted any more. */
  #forgotten = 0;
  #newest = 0;

  constructor(send: (message: AskLivePathMessage) => boolean, nowMs: () => number) {
    this.#send = send;
    this.#nowMs = nowMs;
  }

  ask(question: LiveQuestion): void {
    const lost = this.#underWay !== null && this.#nowMs() - this.#underWay.atMs > LOST_MS;
    if (this.#underWay !== null && !lost) {
      this.#waiting = question;
      return;
    }
    this.#waiting = null;
    this.#sendNow(question);
  }

  /** The cursor has left: what is under way is not shown. */
  forget(): void {
    this.#waiting = null;
    this.#forgotten = this.#nextId - 1;
  }

  /** The answer with how long it took, or null where nobody waits for it. */
  receive(answer: LivePathMessage): LiveAnswer | null {
    const sent = this.#underWay;
    const mine = sent !== null && sent.id === answer.request_id;
    const tookMs = mine ? this.#nowMs() - sent.atMs : 0;
    if (mine) {
      this.#underWay = null;
      const next = this.#waiting;
      this.#waiting = null;
      if (next !== null) this.#sendNow(next);
    }
    if (answer.request_id <= this.#forgotten || answer.request_id < this.#newest) return null;
    this.#newest = answer.request_id;
    return { answer, tookMs };
  }

  /** A new connection: nothing is under way. */
  reset(): void {
    this.#underWay = null;
    this.forget();
  }

  #sendNow(question: LiveQuestion): void {
    const id = this.#nextId;
    this.#nextId += 1;
    this.#underWay = this.#send({ type: "live_path", request_id: id, ...question })
      ? { id, atMs: this.#nowMs() }
      : null;
  }
}

/** Shorter than this, a new part of a way or a shift of its end is rounding. */
const SMALL_MM = 0.3;

/** Lines beside the cursor; `warns` where there is no way. */
export function livePathLines(answer: LivePathMessage): { lines: readonly string[]; warns: boolean } {
  if (answer.problem !== null || answer.length_mm === null) {
    return { lines: [firstSentences(sentence(answer.problem ?? "no way through here"))], warns: true };
  }
  const lines = [`${mm(answer.length_mm, 0)} from the root`];
  if (answer.min_diameter_mm !== null) lines.push(`narrowest ${mm(answer.min_diameter_mm)}`);
  if (answer.confidence !== null) lines.push(`${fixed(100 * answer.confidence)} % sure`);
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
