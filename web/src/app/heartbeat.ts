/**
 * Scheduler that calls a function at every display refresh during activity, and a few times per second at rest. The
 * browser composites a page that requests every refresh, and an idle window used a fifth of a processor core.
 */

/** Time, ms, after the last user input during which every refresh is requested. */
export const AWAKE_MS = 1500;
/** Interval, ms, between checks at rest for inputs without events, such as a gamepad. */
export const DOZE_MS = 100;

/** Clock, timers and activity test that {@link Heartbeat} uses; tests supply fakes. */
export interface HeartbeatHooks {
  nowMs(): number;
  /** Schedule a call at the next display refresh; return a function that cancels it. */
  nextRefresh(call: () => void): () => void;
  after(ms: number, call: () => void): () => void;
  /** Return whether the page needs every refresh: something moves, is held, or must be read. */
  goesOn(): boolean;
}

/** Scheduler of the page's periodic work. */
export class Heartbeat {
  readonly #tick: (elapsedS: number) => void;
  readonly #hooks: HeartbeatHooks;
  #callOff: (() => void) | null = null;
  #dozes = false;
  #lastMs = 0;
  #wokenMs = 0;

  constructor(tick: (elapsedS: number) => void, hooks: HeartbeatHooks) {
    this.#tick = tick;
    this.#hooks = hooks;
  }

  start(): void {
    this.#lastMs = this.#wokenMs = this.#hooks.nowMs();
    this.#next();
  }

  stop(): void {
    this.#callOff?.();
    this.#callOff = null;
  }

  /** Request every refresh from the next one on, because the user gave input or an activity began. */
  wake = (): void => {
    if (this.#callOff === null) return;
    this.#wokenMs = this.#hooks.nowMs();
    if (!this.#dozes) return;
    // Restart the time measurement, because a key that is pressed now was not held during the rest.
    this.#lastMs = this.#wokenMs;
    this.#callOff();
    this.#next();
  };

  #next(): void {
    this.#dozes = this.#hooks.nowMs() - this.#wokenMs >= AWAKE_MS;
    this.#callOff = this.#dozes ? this.#hooks.after(DOZE_MS, this.#beat) : this.#hooks.nextRefresh(this.#beat);
  }

  #beat = (): void => {
    const now = this.#hooks.nowMs();
    const elapsedMs = now - this.#lastMs;
    this.#lastMs = now;
    this.#tick(elapsedMs / 1000);
    if (this.#callOff === null) return;
    if (this.#hooks.goesOn()) this.#wokenMs = now;
    this.#next();
  };
}

/** Names of the events that count as user input. */
const SIGNS = ["keydown", "keyup", "pointerdown", "pointermove", "pointerup", "wheel", "gamepadconnected"] as const;

/** Wake the heartbeat at every user input; return a function that removes the listeners. */
export function wakeByHand(target: EventTarget, wake: () => void): () => void {
  const how = { capture: true, passive: true } as const;
  for (const sign of SIGNS) target.addEventListener(sign, wake, how);
  return () => {
    for (const sign of SIGNS) target.removeEventListener(sign, wake, how);
  };
}
