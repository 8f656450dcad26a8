/** What the hand does on the phone's page, and when which of it is said. */

import type { PhoneMessage } from "../wire/messages";
import type { Wxyz } from "./orientation";

/** No more often than this: a screen of 120 Hz says nothing new in between. */
const LEAST_S = 1 / 65;
/** While something is held it is said anew, since Carina lets go of what is silent. */
const AGAIN_S = 0.1;

export type Held = "turn" | "forward" | "back";

/** Pure: the time is passed in, and `send` gets what is to be said. */
export class Hand {
  readonly #send: (message: PhoneMessage) => boolean;
  readonly #held = new Set<Held>();
  #orientation: Wxyz | null = null;
  #isNew = false;
  #saidS = Number.NEGATIVE_INFINITY;
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

  /** The finger is off everything: another app, another page, the lock screen. */
  letGo(): void {
    this.#held.clear();
  }

  /** Once per refresh. A phone that lies on the table says nothing, so that other devices may move the tip. */
  tick(nowS: number): void {
    const held = this.#held.has("turn");
    const advance = Number(this.#held.has("forward")) - Number(this.#held.has("back"));
    const is = `${held} ${advance}`;
    const changed = is !== this.#was;
    if (!changed) {
      if (this.#held.size === 0) return;
      const passedS = nowS - this.#saidS;
      if (passedS < (this.#isNew && held ? LEAST_S : AGAIN_S)) return;
    }
    const said = this.#send({
      type: "phone_sample",
      time_s: nowS,
      orientation_wxyz: this.#orientation,
      held,
      advance,
    });
    if (!said) return;
    this.#was = is;
    this.#saidS = nowS;
    this.#isNew = false;
  }
}
