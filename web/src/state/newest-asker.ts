/** Questions that a cursor asks: which one goes out, and which answer still counts. */

/** Where a server has not answered for so long, it is asked again. */
const LOST_MS = 2000;

export interface Answered<Answer> {
  readonly answer: Answer;
  /** From the question's sending to here. */
  readonly tookMs: number;
  /** A newer question waits: this is the answer to where the cursor was. */
  readonly overtaken: boolean;
}

/**
 * Asks the newest question only, and not before the last one was answered: a slow machine is not asked more than it can
 * answer, a fast one is asked at once.
 */
export class NewestAsker<Question, Answer extends { readonly request_id: number }> {
  readonly #send: (id: number, question: Question) => boolean;
  readonly #nowMs: () => number;
  #nextId = 1;
  #underWay: { id: number; atMs: number } | null = null;
  #waiting: Question | null = null;
  /** Answers up to this one are not wanted any more. */
  #forgotten = 0;
  #newest = 0;

  constructor(send: (id: number, question: Question) => boolean, nowMs: () => number) {
    this.#send = send;
    this.#nowMs = nowMs;
  }

  ask(question: Question): void {
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
  receive(answer: Answer): Answered<Answer> | null {
    // Of a question that was not asked here.
    if (answer.request_id >= this.#nextId) return null;
    const sent = this.#underWay;
    const mine = sent !== null && sent.id === answer.request_id;
    const tookMs = mine ? this.#nowMs() - sent.atMs : 0;
    const next = this.#waiting;
    if (mine) {
      this.#underWay = null;
      this.#waiting = null;
      if (next !== null) this.#sendNow(next);
    }
    if (answer.request_id <= this.#forgotten || answer.request_id < this.#newest) return null;
    this.#newest = answer.request_id;
    return { answer, tookMs, overtaken: next !== null };
  }

  /** A new connection: nothing is under way. */
  reset(): void {
    this.#underWay = null;
    this.forget();
  }

  #sendNow(question: Question): void {
    const id = this.#nextId;
    this.#nextId += 1;
    this.#underWay = this.#send(id, question) ? { id, atMs: this.#nowMs() } : null;
  }
}
