/** Requests for the preview of an edit, while a tool with a preview is active. */

import type { PreviewQuestion } from "../state/edit-preview";
import { LatestRequestQueue } from "../state/latest-request-queue";
import type { EditPreviewMessage } from "../wire/messages";
import type { Station } from "./station";

/**
 * Time, ms, for which the preview of an earlier cursor position stays visible (faint), so that the line follows the
 * hand. Later it is hidden, because a click would give another result.
 */
export const STALE_MS = 120;
/** Time, ms, for which the cursor must rest before the branches that the edit would rename are requested. */
export const REST_MS = 250;

/** Requests the preview of an edit for the cursor position, and shows the answers. */
export class Previewing {
  readonly #station: Station;
  readonly #queue: LatestRequestQueue<PreviewQuestion & { with_names: boolean }, EditPreviewMessage>;
  #last: PreviewQuestion | null = null;
  #timer: ReturnType<typeof setTimeout> | null = null;
  #restTimer: ReturnType<typeof setTimeout> | null = null;

  constructor(station: Station) {
    this.#station = station;
    this.#queue = new LatestRequestQueue(
      (id, question) => station.send({ type: "preview_edit", request_id: id, ...question }),
      () => performance.now(),
    );
  }

  request(question: PreviewQuestion): void {
    if (this.#last !== null && sameQuestion(this.#last, question)) return;
    this.#last = question;
    this.#outdated();
    this.#queue.request({ ...question, with_names: false });
  }

  /** Request the preview at the same position again, because the tree has changed. */
  again(): void {
    if (this.#last === null) return;
    this.#outdated();
    this.#queue.request({ ...this.#last, with_names: false });
  }

  /** Clear the preview, because the cursor has left or no tool is active. */
  forget(): void {
    this.#last = null;
    this.#stopRestTimer();
    this.#queue.forget();
    this.#stopTimer();
    if (this.#station.state.preview !== null) this.#station.store.dispatch({ kind: "preview", preview: null });
  }

  /** Discard all unanswered requests, because a new connection will not answer them. */
  reset(): void {
    this.forget();
    this.#queue.reset();
  }

  receive(answer: EditPreviewMessage): void {
    const fresh = this.#queue.receive(answer);
    if (fresh === null) return;
    this.#stopTimer();
    this.#station.store.dispatch({ kind: "preview", preview: { answer: fresh.answer, stale: fresh.overtaken } });
    if (fresh.overtaken) this.#dropLater();
    else this.#requestNamesAtRest(fresh.answer);
  }

  /** Request the names when the cursor has rested: naming takes longer than a preview that follows the cursor may. */
  #requestNamesAtRest(answer: EditPreviewMessage): void {
    this.#stopRestTimer();
    const question = this.#last;
    if (answer.renamed !== null || answer.problem !== null || question === null) return;
    this.#restTimer = setTimeout(() => {
      if (this.#last === question) this.#queue.request({ ...question, with_names: true });
    }, REST_MS);
  }

  #outdated(): void {
    this.#stopRestTimer();
    const { preview } = this.#station.state;
    if (preview === null) this.#station.store.dispatch({ kind: "preview", preview: { answer: null, stale: true } });
    else if (!preview.stale) {
      this.#station.store.dispatch({ kind: "preview", preview: { ...preview, stale: true } });
      this.#dropLater();
    }
  }

  #dropLater(): void {
    this.#stopTimer();
    this.#timer = setTimeout(() => {
      this.#station.store.dispatch({ kind: "preview", preview: { answer: null, stale: true } });
    }, STALE_MS);
  }

  #stopRestTimer(): void {
    if (this.#restTimer !== null) clearTimeout(this.#restTimer);
    this.#restTimer = null;
  }

  #stopTimer(): void {
    if (this.#timer !== null) clearTimeout(this.#timer);
    this.#timer = null;
  }
}

function sameQuestion(a: PreviewQuestion, b: PreviewQuestion): boolean {
  const samePoint = a.lps === b.lps || (a.lps !== null && b.lps !== null && a.lps.every((v, n) => v === b.lps?.[n]));
  return (
    samePoint &&
    a.tool === b.tool &&
    a.branch_id === b.branch_id &&
    a.frame_id === b.frame_id &&
    a.column === b.column &&
    a.row === b.row
  );
}
