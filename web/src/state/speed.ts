/** Speed of the tip, computed from the latest poses, whatever input device moves the tip. */

import { distance, type Vec3 } from "./vec";

/** Initial speed of the automatic flight, mm/s. */
export const AUTO_SPEED_MM_S = 20;
/** Speeds of the automatic flight that the user can select, mm/s. */
export const AUTO_SPEEDS_MM_S = [2, 5, 10, 20, 30, 50, 100] as const;

/** Averaging window of the speed, ms: long enough for poses that arrive in bursts, short enough to follow the hand. */
const WINDOW_MS = 600;
/** Minimum time span of a measured speed, ms; a shorter span gives a noisy speed. */
const MIN_MS = 200;
/** Time in ms without a new pose after which the tip counts as not moving. */
const STILL_MS = 300;
/**
 * Maximum step between two poses, mm, that counts as movement; a larger step is a jump. It corresponds to 500 mm/s, the
 * fastest stick speed, at 30 poses/s.
 */
const JUMP_MM = 17;

/** Meter of the tip's speed. */
export class SpeedMeter {
  #at: Vec3 | null = null;
  #steps: { atMs: number; mm: number }[] = [];
  #beganMs = 0;

  poseArrived(at: Vec3, nowMs: number): void {
    const before = this.#at;
    this.#at = at;
    if (before === null) return;
    const mm = distance(before, at);
    if (mm > JUMP_MM) {
      this.#steps = [];
      return;
    }
    if (mm === 0) return;
    const last = this.#steps.at(-1);
    if (last === undefined || nowMs - last.atMs > STILL_MS) {
      // Start the measurement at the second pose of a movement, because the duration of the first step is unknown.
      this.#steps = [{ atMs: nowMs, mm: 0 }];
      this.#beganMs = nowMs;
      return;
    }
    this.#steps.push({ atMs: nowMs, mm });
    while ((this.#steps[0]?.atMs ?? nowMs) < nowMs - WINDOW_MS) this.#steps.shift();
  }

  /** Return the speed of the tip in mm/s; null if the tip does not move. */
  read(nowMs: number): number | null {
    const last = this.#steps.at(-1);
    if (last === undefined || nowMs - last.atMs > STILL_MS) return null;
    const first = this.#steps[0] ?? last;
    // A step is stored with its end time, so the first stored step is before the measured time span.
    const span = last.atMs - first.atMs;
    if (last.atMs - this.#beganMs < MIN_MS || span <= 0) return null;
    const mm = this.#steps.slice(1).reduce((sum, step) => sum + step.mm, 0);
    return (1000 * mm) / span;
  }

  reset(): void {
    this.#at = null;
    this.#steps = [];
  }
}

/** Return the speed as displayed: whole mm/s, or tenths below 10 mm/s; null at rest. */
export function shownSpeed(speed: number | null): number | null {
  if (speed === null) return null;
  return speed < 9.95 ? Math.round(speed * 10) / 10 : Math.round(speed);
}
