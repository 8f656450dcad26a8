/**
 * Calls once per refresh of the screen while something goes on, and a few times a second while nothing does. A browser
 * that is asked for every refresh composes every one: an open window at rest took a fifth of a processor for nothing.
 */

/** So long after the last sign of a hand every refresh is still asked for. */
export const AWAKE_MS = 1500;
/** Between two looks at what tells nobody that it has begun, such as a gamepad. */
export const DOZE_MS = 100;

export interface HeartbeatSurroundings {
  nowMs(): number;
  /** Both return how to call it off. */
  nextRefresh(call: () => void): () => void;
  after(ms: number, call: () => void): () => void;
  /** Whether anything moves by itself, is held, or has to be read. */
  goesOn(): boolean;
}

export class Heartbeat {
  readonly #tick: (elapsedS: number) => void;
  readonly #around: HeartbeatSurroundings;
  #callOff: (() => void) | null = null;
  #dozes = false;
  #lastMs = 0;
  #wokenMs = 0;

  constructor(tick: (elapsedS: number) => void, around: HeartbeatSurroundings) {
    this.#tick = tick;
    this.#around = around;
  }

  start(): void {
    this.#lastMs = this.#wokenMs = this.#around.nowMs();
    this.#next();
  }

  stop(): void {
    this.#callOff?.();
    this.#callOff = null;
  }

  /** A hand has moved, or something has begun: from the next refresh on every one is asked for. */
  wake = (): void => {
    if (this.#callOff === null) return;
    this.#wokenMs = this.#around.nowMs();
    if (!this.#dozes) return;
    // What is held from now on has not been held while nobody looked.
    this.#lastMs = this.#wokenMs;
    this.#callOff();
    this.#next();
  };

  #next(): void {
    this.#dozes = this.#around.nowMs() - this.#wokenMs >= AWAKE_MS;
    this.#callOff = this.#dozes ? this.#around.after(DOZE_MS, this.#beat) : this.#around.nextRefresh(this.#beat);
  }

  #beat = (): void => {
    const now = this.#around.nowMs();
    const elapsedMs = now - this.#lastMs;
    this.#lastMs = now;
    this.#tick(elapsedMs / 1000);
    if (this.#callOff === null) return;
    if (this.#around.goesOn()) this.#wokenMs = now;
    this.#next();
  };
}

/** What a hand does in a page. */
const SIGNS = ["keydown", "keyup", "pointerdown", "pointermove", "pointerup", "wheel", "gamepadconnected"] as const;

/** Wakes at every sign of a hand; returns how to stop that. */
export function wakeByHand(target: EventTarget, wake: () => void): () => void {
  const how = { capture: true, passive: true } as const;
  for (const sign of SIGNS) target.addEventListener(sign, wake, how);
  return () => {
    for (const sign of SIGNS) target.removeEventListener(sign, wake, how);
  };
}
