/** Preview of a CT that the server is opening. */

import type { OpeningMessage, OpeningSlice } from "../wire/messages";
import { fixed } from "./format";

/** Return the preview to show after a message; null at the end of an opening, and for a job that the user cancelled. */
export function shownOpening(message: OpeningMessage, cancelledJobs: readonly string[]): OpeningMessage | null {
  return message.job_id === null || cancelledJobs.includes(message.job_id) ? null : message;
}

/** Return the number and the position of a slice as text: `Slice 301 of 600, S 12.1 mm`. */
export function sliceText({ number, num_slices, height_lps_mm }: OpeningSlice): string {
  const side = height_lps_mm < 0 ? "I" : "S";
  return `Slice ${number} of ${num_slices}, ${side} ${fixed(Math.abs(height_lps_mm), 1)} mm`;
}
