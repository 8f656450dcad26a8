/** Detection of contacts between the tip and the airway wall, for haptic feedback. */

import type { PoseMessage } from "../../wire/messages";

/** Detector that receives every pose, and returns true when a contact between tip and wall begins. */
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
    // In the scope simulation the wall stops the tip, so the tip never leaves the lumen. The simulation counts contacts
    // instead, from 0 after each restart.
    this.#contacts = pose.scope.num_contacts;
    return before !== null && pose.scope.num_contacts > before;
  }
}
