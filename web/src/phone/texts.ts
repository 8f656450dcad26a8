/** Status texts of the phone page. */

import type { PhoneStateMessage } from "../wire/messages";

const CONTROL_TEXTS = {
  absolute: "absolute mode",
  relative: "relative mode",
  path: "path mode",
} as const;

/** Return the text that the phone page shows for a state message of the server. */
export function stateText(state: PhoneStateMessage): string {
  if (state.words !== "") return state.words;
  if (!state.case_open) return "Connected. Open a case on the workstation.";
  const how = state.scope_held ? "scope mode" : CONTROL_TEXTS[state.control];
  return `${state.holds ? "This phone moves the tip" : "Connected"}: ${how}.`;
}

/** Time, ms, after which a phone without a reported orientation counts as a phone without a sensor. */
export const SENSOR_WITHIN_MS = 2000;
/** Text for a phone without an orientation sensor. */
export const NO_SENSOR = "This phone or browser does not report its orientation. Forward and back still work.";
/** Text for a phone whose user has refused access to the sensor. */
export const SENSOR_REFUSED =
  "The browser was not allowed to read the phone's orientation. Close this page, open it again, and allow access.";
