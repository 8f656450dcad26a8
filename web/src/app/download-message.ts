/** Messages about videos and pictures that were not saved. */

import { DownloadError } from "../net/download";
import type { Message } from "../state/app-state";

/** Codes of the errors of a job that a user has cancelled. */
const CANCELLED: ReadonlySet<string> = new Set(["export.video-stopped", "plan.sheet-stopped"]);

/**
 * Return the message about a file that was not saved; null if the user has cancelled its job in this window.
 *
 * @param subject The file as the subject of a sentence, such as "The video".
 * @param isCancelledHere Whether this window has cancelled the job.
 */
export function downloadMessage(error: unknown, subject: string, isCancelledHere: boolean): Omit<Message, "id"> | null {
  const checkCarina = "Check that Carina is still running.";
  if (!(error instanceof DownloadError)) {
    const message = `${subject} could not be downloaded from Carina.`;
    return { kind: "error", code: "download.failed", message, action: checkCarina };
  }
  if (!CANCELLED.has(error.code)) return { kind: "error", code: error.code, message: error.message, action: null };
  if (isCancelledHere) return null;
  return { kind: "error", code: error.code, message: `${subject} was cancelled in another window.`, action: null };
}
