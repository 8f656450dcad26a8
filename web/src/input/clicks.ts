/** The number of a click in a series, and the one action that the series causes. */

export interface PointerPlace {
  /** CSS pixels from the picture's top-left corner. */
  x: number;
  y: number;
}

/** What browsers wait for a second click, where nobody set it otherwise. */
const SERIES_MS = 500;
/** Two clicks nearer than this are at one place: a finger is less exact than a mouse. */
const NEAR_PX = { mouse: 6, finger: 24 } as const;

/** Counts clicks that follow each other at one place. For fingers and pens, whose clicks browsers do not count, and for rows that move. */
export class ClickCounter {
  #last: { at: PointerPlace; atMs: number; count: number } | null = null;

  /** 1 for a click of its own, 2 for the second of a double click, and on. */
  count(at: PointerPlace, atMs: number, by: keyof typeof NEAR_PX): number {
    const last = this.#last;
    const follows =
      last !== null && atMs - last.atMs < SERIES_MS && Math.hypot(at.x - last.at.x, at.y - last.at.y) <= NEAR_PX[by];
    const count = follows ? last.count + 1 : 1;
    this.#last = { at, atMs, count };
    return count;
  }

  /** Something else came between: a drag, a key. */
  forget(): void {
    this.#last = null;
  }
}

/**
 * What a click is for. The first one of a series does what is in the hand, or chooses; what follows at the same place
 * belongs to it: with a tool it does nothing, without one every second click makes the picture large, or small again.
 */
export function clickAction(count: number, forTool: boolean): "click" | "enlarge" | "nothing" {
  if (count === 1) return "click";
  return forTool || count % 2 === 1 ? "nothing" : "enlarge";
}

/** An action that cannot be undone, such as a flight: it runs when a second click can no longer follow. */
export class DelayedAction {
  #waiting: ReturnType<typeof setTimeout> | null = null;
  #done = false;

  constructor(readonly waitMs = 300) {}

  begin(action: () => void): void {
    this.cancel();
    this.#done = false;
    this.#waiting = setTimeout(() => {
      this.#waiting = null;
      this.#done = true;
      action();
    }, this.waitMs);
  }

  /** Another series of clicks begins: what was done belongs to the one before. */
  renew(): void {
    this.#done = false;
  }

  /** False where it is too late: it has been done. */
  cancel(): boolean {
    if (this.#waiting !== null) clearTimeout(this.#waiting);
    this.#waiting = null;
    return !this.#done;
  }
}
