/** Queue of requests at the cursor: decides which request is sent, and which answer is valid. */

/** Time, ms, after which a new request is sent although the previous one has no answer. */
const LOST_MS = 2000;

/** Answer to a request at the cursor, with its response time. */
export interface Answered<Answer> {
  readonly answer: Answer;
  /** Time in ms from the request to its answer. */
  readonly tookMs: number;
  /** Whether a later request is waiting, so that this answer is for an earlier cursor position. */
  readonly overtaken: boolean;
}

/**
 * Request queue that sends only the latest request, and only after the previous request was answered. A slow server
 * therefore never has a backlog.
 */
export class LatestRequestQueue<Question, Answer extends { readonly request_id: number }> {
  readonly #send: (id: number, question: Question) => boolean;
  readonly #nowMs: () => number;
  #nextId = 1;
  #underWay: { id: number; atMs: number } | null = null;
  #waiting: Question | null = null;
  /** Answers with a request identifier up to this value are discarded. */
  #lastDropped = 0;
  #latestAnswered = 0;

  constructor(send: (id: number, question: Question) => boolean, nowMs: () => number) {
    this.#send = send;
    this.#nowMs = nowMs;
  }

  request(question: Question): void {
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
    this.#lastDropped = this.#nextId - 1;
  }

  /** Return the answer with its response time; null if the answer is outdated or not expected. */
  receive(answer: Answer): Answered<Answer> | null {
    // No request with this identifier was sent on this connection.
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
    if (answer.request_id <= this.#lastDropped || answer.request_id < this.#latestAnswered) return null;
    this.#latestAnswered = answer.request_id;
    return { answer, tookMs, overtaken: next !== null };
  }

  /** Discard all unanswered requests, because a new connection will not answer them. */
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
