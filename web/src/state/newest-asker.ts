/** Requests at the cursor: which request is sent, and which answer is valid. */

/** Time, ms, after which an unanswered request is sent again. */
const LOST_MS = 2000;

/** An answer with its response time. */
export interface Answered<Answer> {
  readonly answer: Answer;
  /** Time from the request to the answer, ms. */
  readonly tookMs: number;
  /** Whether a newer request waits, so that this answer is for an earlier cursor position. */
  readonly overtaken: boolean;
}

/**
 * Request queue that sends only the latest request, and only after the previous one was answered, so that a slow server
 * never has a backlog.
 */
export class NewestAsker<Question, Answer extends { readonly request_id: number }> {
  readonly #send: (id: number, question: Question) => boolean;
  readonly #nowMs: () => number;
  #nextId = 1;
  #underWay: { id: number; atMs: number } | null = null;
  #waiting: Question | null = null;
  /** Answers with an identifier up to this one are discarded. */
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

  /** Discard the answers to all requests, because the cursor has left. */
  forget(): void {
    this.#waiting = null;
    this.#forgotten = this.#nextId - 1;
  }

  /** Return the answer with its response time, or null if the answer is not expected. */
  receive(answer: Answer): Answered<Answer> | null {
    // The request was not sent by this connection.
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

  /** Forget all requests, for a new connection. */
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
