/** Counting of clicks in a series (double click), and the action of a series. */

/** Position of a pointer in a picture. */
export interface PointerPlace {
  /** CSS pixels from the picture's top-left corner. */
  x: number;
  y: number;
}

/** Longest time between two clicks of a series, ms: the browsers' default. */
const SERIES_MS = 500;
/** Largest distance, CSS px, between two clicks of a series; larger for a finger, which is less exact than a mouse. */
const NEAR_PX = { mouse: 6, finger: 24 } as const;

/**
 * Counter of successive clicks at the same place, for touch and pen input, whose clicks browsers do not count, and for
 * list rows that move.
 */
export class ClickCounter {
  #last: { at: PointerPlace; atMs: number; count: number } | null = null;

  /** Return the number of this click in its series: 1 for the first click, 2 for the second of a double click. */
  count(at: PointerPlace, atMs: number, by: keyof typeof NEAR_PX): number {
    const last = this.#last;
    const follows =
      last !== null && atMs - last.atMs < SERIES_MS && Math.hypot(at.x - last.at.x, at.y - last.at.y) <= NEAR_PX[by];
    const count = follows ? last.count + 1 : 1;
    this.#last = { at, atMs, count };
    return count;
  }

  /** Begin a new series, because another input such as a drag or a key occurred. */
  forget(): void {
    this.#last = null;
  }
}

/**
 * Return the action of a click by its number in the series.
 *
 * The first click uses the active tool, or selects. Later clicks of the series do nothing with a tool; without a tool
 * every second click enlarges the picture or restores its size.
 */
export function clickAction(count: number, forTool: boolean): "click" | "enlarge" | "nothing" {
  if (count === 1) return "click";
  return forTool || count % 2 === 1 ? "nothing" : "enlarge";
}

/** A delayed action that cannot be undone, such as a flight. It runs once a second click can no longer follow. */
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

  /** Begin a new series of clicks: the action of the previous series can no longer be cancelled. */
  renew(): void {
    this.#done = false;
  }

  /** Cancel the action; return false if it has already run. */
  cancel(): boolean {
    if (this.#waiting !== null) clearTimeout(this.#waiting);
    this.#waiting = null;
    return !this.#done;
  }
}
