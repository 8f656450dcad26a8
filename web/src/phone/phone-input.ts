/** The user's input on the phone page (held buttons and orientation), and the times at which it is sent. */

import type { PhoneMessage } from "../wire/messages";
import type { Wxyz } from "./orientation";

/** Minimum interval between two messages, s: more frequent ones, as at 120 Hz, would have no effect. */
const MIN_S = 1 / 65;
/**
 * Interval, s, at which held input is sent again, because the server releases the input of a phone that sends nothing.
 */
const AGAIN_S = 0.1;

/** Name of a button on the phone page that the user can hold. */
export type Held = "turn" | "forward" | "back";

/**
 * State of the held buttons and of the phone's orientation. The object has no clock: the caller passes the time, and
 * `send` receives the messages.
 */
export class PhoneInput {
  readonly #send: (message: PhoneMessage) => boolean;
  readonly #held = new Set<Held>();
  #orientation: Wxyz | null = null;
  #isNew = false;
  #sentS = Number.NEGATIVE_INFINITY;
  #was = "false 0";

  constructor(send: (message: PhoneMessage) => boolean) {
    this.#send = send;
  }

  get holds(): ReadonlySet<Held> {
    return this.#held;
  }

  turned(orientation: Wxyz | null): void {
    if (orientation === null) return;
    this.#orientation = orientation;
    this.#isNew = true;
  }

  hold(what: Held, down: boolean): void {
    if (down) this.#held.add(what);
    else this.#held.delete(what);
  }

  /** Release all buttons, because the user has switched to another app, another page or the lock screen. */
  release(): void {
    this.#held.clear();
  }

  /**
   * Send the phone's orientation and held buttons if they changed or if it is time to repeat them; call this function
   * once per display refresh. A phone without held buttons repeats nothing, so that other devices can move the tip.
   */
  tick(nowS: number): void {
    const held = this.#held.has("turn");
    const advance = Number(this.#held.has("forward")) - Number(this.#held.has("back"));
    const is = `${held} ${advance}`;
    const changed = is !== this.#was;
    if (!changed) {
      if (this.#held.size === 0) return;
      const passedS = nowS - this.#sentS;
      if (passedS < (this.#isNew && held ? MIN_S : AGAIN_S)) return;
    }
    const wasSent = this.#send({
      type: "phone_sample",
      time_s: nowS,
      orientation_wxyz: this.#orientation,
      held,
      advance,
    });
    if (!wasSent) return;
    this.#was = is;
    this.#sentS = nowS;
    this.#isNew = false;
  }
}
