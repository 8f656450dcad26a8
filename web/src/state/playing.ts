/** The flight through the key frames, as it is played. */

import { fixed } from "./format";

export interface Playing {
  readonly on: boolean;
  /** Where the flight is, or was last. */
  readonly atS: number;
  readonly rate: number;
}

export const NOT_PLAYING: Playing = { on: false, atS: 0, rate: 1 };
export const PLAY_RATES = [0.5, 1, 2] as const;
export const KEY_SPEEDS_MM_S = [2, 5, 10, 20, 30, 50, 100] as const;

/** `0:07.5` */
export function clock(seconds: number): string {
  const tenths = Math.round(seconds * 10);
  const minutes = Math.floor(tenths / 600);
  return `${minutes}:${fixed((tenths - minutes * 600) / 10, 1).padStart(4, "0")}`;
}

/** The last key frame that the flight has passed at a time; -1 where there is none. */
export function passedKey(keys: readonly { time_s: number }[], atS: number): number {
  // A hundredth of a second: what was rounded on the way is still there.
  return keys.findLastIndex((key) => key.time_s <= atS + 0.01);
}
