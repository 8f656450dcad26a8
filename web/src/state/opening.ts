/** State of a CT that the server is opening: the series of its folder with pictures, and a preview of one slice. */

import type { OpeningMessage, OpeningSlice, SeriesPictureMessage } from "../wire/messages";
import { fixed } from "./format";

/** A CT that is being opened. */
export interface Opening {
  readonly message: OpeningMessage;
  /** Pictures of the listed series, PNG in base64, by key of the series. */
  readonly pictures: Readonly<Record<string, string>>;
}

/** Return the opening after a message; null at the end of an opening, and for a job that the user cancelled. */
export function openingAfter(
  before: Opening | null,
  message: OpeningMessage,
  cancelledJobs: readonly string[],
): Opening | null {
  if (message.job_id === null || cancelledJobs.includes(message.job_id)) return null;
  // The list stays if another series of the same folder is opened instead.
  return { message, pictures: before?.message.list_id === message.list_id ? before.pictures : {} };
}

/** Return the opening without the CT of a job that has ended or was cancelled. */
export function openingWithout(opening: Opening | null, jobId: string): Opening | null {
  return opening?.message.job_id === jobId ? null : opening;
}

/** Return the opening with a picture of a series; unchanged if the picture belongs to another list. */
export function openingWithPicture(opening: Opening | null, picture: SeriesPictureMessage): Opening | null {
  if (opening === null || opening.message.list_id !== picture.list_id) return opening;
  return { ...opening, pictures: { ...opening.pictures, [picture.key]: picture.picture } };
}

/** Return whether the folder of a CT that is being opened contains several series, which are then listed. */
export function listsSeries(opening: Opening | null): boolean {
  return opening !== null && opening.message.series.length > 1;
}

/** Return the number and the position of a slice as text: `Slice 301 of 600, S 12.1 mm`. */
export function sliceText({ number, num_slices, height_lps_mm }: OpeningSlice): string {
  const side = height_lps_mm < 0 ? "I" : "S";
  return `Slice ${number} of ${num_slices}, ${side} ${fixed(Math.abs(height_lps_mm), 1)} mm`;
}
