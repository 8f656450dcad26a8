/**
 * Scheduler that calls a function at every display refresh during activity, and a few times per second at rest. The
 * browser composites a page that requests every refresh, and an idle window used a fifth of a processor core.
 */

/** Duration, ms, after the last user input, during which the page acts at every display refresh. */
export const ACTIVE_MS = 1500;
/** Interval, ms, between checks at rest for inputs without events, such as a gamepad. */
export const IDLE_POLL_MS = 100;

/** Clock, timers and activity test that {@link RefreshScheduler} uses; tests supply fakes. */
export interface RefreshHooks {
  nowMs(): number;
  /** Schedule a call at the next display refresh; return a function that cancels it. */
  nextRefresh(call: () => void): () => void;
  after(ms: number, call: () => void): () => void;
  /** Return whether the page needs every refresh: something moves, is held, or must be read. */
  needsEveryRefresh(): boolean;
}

/** Scheduler of the page's periodic work. */
export class RefreshScheduler {
  readonly #tick: (elapsedS: number) => void;
  readonly #hooks: RefreshHooks;
  #cancelNext: (() => void) | null = null;
  #isIdle = false;
  #lastMs = 0;
  #lastActivityMs = 0;

  constructor(tick: (elapsedS: number) => void, hooks: RefreshHooks) {
    this.#tick = tick;
    this.#hooks = hooks;
  }

  start(): void {
    this.#lastMs = this.#lastActivityMs = this.#hooks.nowMs();
    this.#scheduleNext();
  }

  stop(): void {
    this.#cancelNext?.();
    this.#cancelNext = null;
  }

  /** Act at every display refresh from the next one on, because the user gave input or an activity began. */
  wake = (): void => {
    if (this.#cancelNext === null) return;
    this.#lastActivityMs = this.#hooks.nowMs();
    if (!this.#isIdle) return;
    // Restart the time measurement, because a key that is pressed now was not held during the rest.
    this.#lastMs = this.#lastActivityMs;
    this.#cancelNext();
    this.#scheduleNext();
  };

  #scheduleNext(): void {
    this.#isIdle = this.#hooks.nowMs() - this.#lastActivityMs >= ACTIVE_MS;
    this.#cancelNext = this.#isIdle ? this.#hooks.after(IDLE_POLL_MS, this.#run) : this.#hooks.nextRefresh(this.#run);
  }

  #run = (): void => {
    const now = this.#hooks.nowMs();
    const elapsedMs = now - this.#lastMs;
    this.#lastMs = now;
    this.#tick(elapsedMs / 1000);
    if (this.#cancelNext === null) return;
    if (this.#hooks.needsEveryRefresh()) this.#lastActivityMs = now;
    this.#scheduleNext();
  };
}

/** Names of the events that count as user input. */
const INPUT_EVENTS = [
  "keydown",
  "keyup",
  "pointerdown",
  "pointermove",
  "pointerup",
  "wheel",
  "gamepadconnected",
] as const;

/** Wake the scheduler at every user input; return a function that removes the listeners. */
export function wakeOnInput(target: EventTarget, wake: () => void): () => void {
  const options = { capture: true, passive: true } as const;
  for (const event of INPUT_EVENTS) target.addEventListener(event, wake, options);
  return () => {
    for (const event of INPUT_EVENTS) target.removeEventListener(event, wake, options);
  };
}
