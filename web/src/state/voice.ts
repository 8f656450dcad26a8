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

/** Return the text to speak after a change of the attempt: a new event, or the next step; null for nothing new. */
export function spokenText(before: RunningTask | null, now: RunningTask): string | null {
  if (now.paused) return null;
  const event = now.message !== null && now.message !== before?.message ? sentence(now.message) : null;
  const step = now.next_step !== null && now.next_step !== before?.next_step ? `Next: ${now.next_step}` : null;
  // A fault is spoken alone, so that it is not late.
  if (event !== null && now.is_warning) return event;
  return [event, step].filter((text) => text !== null).join(" ") || null;
}
