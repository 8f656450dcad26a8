/** Detection of contacts between the tip and the airway wall, for haptic feedback. */

import type { PoseMessage } from "../../wire/messages";

/** Detector that receives every pose and returns true at the beginning of a contact. */
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
    // With the scope simulation the tip never leaves the lumen, because the wall stops it; the simulation counts its
    // contacts. The count restarts at 0 with a new simulation.
    this.#contacts = pose.scope.num_contacts;
    return before !== null && pose.scope.num_contacts > before;
  }
}
