/** How fast the tip flies, by whatever hand: the way of the last moments, from the poses as they arrive. */

import { distance, type Vec3 } from "./vec";

/** Of the flight by itself, until a person chooses another. */
export const AUTO_SPEED_MM_S = 20;
export const AUTO_SPEEDS_MM_S = [2, 5, 10, 20, 30, 50, 100] as const;

/** Long enough for poses that come in bunches, short enough for a hand. */
const WINDOW_MS = 600;
/** The first moments of a movement would be all noise. */
const LEAST_MS = 200;
/** Longer than this without a pose, the tip stands. */
const STILL_MS = 300;
/** Farther than this from one pose to the next, the tip was put there: 500 mm/s, the fastest stick, at 30 poses/s. */
const JUMP_MM = 17;

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
      // What led to the first pose of a movement took a time that nobody knows.
      this.#steps = [{ atMs: nowMs, mm: 0 }];
      this.#beganMs = nowMs;
      return;
    }
    this.#steps.push({ atMs: nowMs, mm });
    while ((this.#steps[0]?.atMs ?? nowMs) < nowMs - WINDOW_MS) this.#steps.shift();
  }

  /** mm/s; null at rest. */
  read(nowMs: number): number | null {
    const last = this.#steps.at(-1);
    if (last === undefined || nowMs - last.atMs > STILL_MS) return null;
    const first = this.#steps[0] ?? last;
    // Steps end at their times: the first of the window began before it.
    const span = last.atMs - first.atMs;
    if (last.atMs - this.#beganMs < LEAST_MS || span <= 0) return null;
    const mm = this.#steps.slice(1).reduce((sum, step) => sum + step.mm, 0);
    return (1000 * mm) / span;
  }

  reset(): void {
    this.#at = null;
    this.#steps = [];
  }
}

/** As it is shown: whole mm/s, tenths where they matter. */
export function shownSpeed(speed: number | null): number | null {
  if (speed === null) return null;
  return speed < 9.95 ? Math.round(speed * 10) / 10 : Math.round(speed);
}
