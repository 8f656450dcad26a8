/** Spoken feedback of a running attempt: the choice of a voice of this computer, and the text to speak. */

import type { RunningTask } from "../wire/messages";
import { sentence } from "./format";

/** The fields of a voice of the browser that decide whether it may speak. */
export interface Voice {
  readonly localService: boolean;
  readonly lang: string;
}

/**
 * Return an English voice that this computer computes itself; null without one. The other voices of a browser send the
 * text to a server.
 */
export function localVoice<V extends Voice>(voices: readonly V[]): V | null {
  return voices.find(({ localService, lang }) => localService && /^en\b/i.test(lang)) ?? null;
}

/** The text to speak after a change of the attempt, null for nothing new, and the last step that was spoken. */
export interface Speech {
  readonly text: string | null;
  readonly step: string | null;
}

/**
 * Return the speech after a change of the attempt: a new event, and the next step, unless it was spoken last. The last
 * spoken step is separate from the state before, because a step that changes during a fault or a pause is spoken later.
 */
export function speechAfter(before: RunningTask | null, now: RunningTask, spokenStep: string | null): Speech {
  const last = before?.flight === now.flight ? spokenStep : null;
  if (now.paused) return { text: null, step: last };
  const event = now.message !== null && now.message !== before?.message ? sentence(now.message) : null;
  // A fault is spoken alone, so that it is not late. The step waits, because a new text stops the one being spoken.
  if (now.message !== null && now.is_warning) return { text: event, step: last };
  const step = now.next_step !== null && now.next_step !== last ? `Next: ${now.next_step}` : null;
  return { text: [event, step].filter((text) => text !== null).join(" ") || null, step: now.next_step ?? last };
}
