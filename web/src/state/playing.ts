/** Playback of a flight: whether it runs, its time and its rate. */

import { fixed } from "./format";

/** State of the playback of one flight. */
export interface Playing {
  readonly on: boolean;
  /** Current time in the flight, s; the time of the pause if the playback is paused. */
  readonly atS: number;
  readonly rate: number;
}

/** State of the playback of a flight that has not been started. */
export const NOT_PLAYING: Playing = { on: false, atS: 0, rate: 1 };
/** Playback rates that the user can select, as factors of the real time. */
export const PLAY_RATES = [0.5, 1, 2] as const;
/** Flight speeds between key frames that the user can select, mm/s. */
export const KEY_SPEEDS_MM_S = [2, 5, 10, 20, 30, 50, 100] as const;

/** Return a time in the flight as text, `0:07.5`. */
export function clock(seconds: number): string {
  const tenths = Math.round(seconds * 10);
  const minutes = Math.floor(tenths / 600);
  return `${minutes}:${fixed((tenths - minutes * 600) / 10, 1).padStart(4, "0")}`;
}

/** Return the index of the last key frame that the flight has passed at a time; -1 if there is none. */
export function passedKey(keys: readonly { time_s: number }[], atS: number): number {
  // Tolerance of 0.01 s, because the wire rounds times.
  return keys.findLastIndex((key) => key.time_s <= atS + 0.01);
}
