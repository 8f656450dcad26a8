/** Counting of clicks in a series (double click), and the action of each click in a series. */

/** Position of a pointer in a picture. */
export interface PointerPlace {
  /** Horizontal position from the picture's left edge, CSS px; `y` is measured from the top edge. */
  x: number;
  y: number;
}

/** Maximum time between two clicks of a series, ms: the browsers' default for a double click. */
const SERIES_MS = 500;
/**
 * Maximum distance between two clicks of a series, CSS px. It is larger for a finger, which is less exact than a mouse.
 */
const NEAR_PX = { mouse: 6, finger: 24 } as const;

/**
 * Counter of successive clicks at the same place. Needed for touch and pen input, whose clicks some browsers do not
 * count, and for list rows, which may move between two clicks.
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

  /** Begin a new series with the next click, because a drag, a key or another input occurred. */
  forget(): void {
    this.#last = null;
  }
}

/**
 * Return the action of a click by its number in the series.
 *
 * The first click applies the active tool, or selects. Later clicks of a series with a tool do nothing. Without a tool
 * every second click enlarges the picture or restores its size.
 */
export function clickAction(count: number, forTool: boolean): "click" | "enlarge" | "nothing" {
  if (count === 1) return "click";
  return forTool || count % 2 === 1 ? "nothing" : "enlarge";
}

/** Action that cannot be undone, such as a flight, delayed until a second click is no longer possible. */
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

  /** Begin a new series of clicks, in which the action of the previous series can no longer be cancelled. */
  renew(): void {
    this.#done = false;
  }

  /** Cancel the delayed action; return false if the action has already run. */
  cancel(): boolean {
    if (this.#waiting !== null) clearTimeout(this.#waiting);
    this.#waiting = null;
    return !this.#done;
  }
}
