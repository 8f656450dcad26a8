/** When the hand should feel that the tip has met the wall. */

import type { PoseMessage } from "../../wire/messages";

/** Looks at every pose in turn; true where a contact has begun. */
export class ContactSense {
  #wasInside = true;
  #contacts: number | null = null;

  met(pose: PoseMessage | null): boolean {
    if (pose === null) {
      this.#wasInside = true;
      this.#contacts = null;
      return false;
    }
    const before = this.#contacts;
    const wasInside = this.#wasInside;
    this.#wasInside = pose.inside;
    if (pose.scope === null) {
      this.#contacts = null;
      return wasInside && !pose.inside;
    }
    // A held scope never leaves the lumen: the wall holds it, and its contacts are counted. Laid anew it counts from 0.
    this.#contacts = pose.scope.num_contacts;
    return before !== null && pose.scope.num_contacts > before;
  }
}
