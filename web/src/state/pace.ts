/**
 * Measurement of the airway view's frame rate, and of the latency from the arrival of a pose to the drawing of its
 * picture.
 */

/** Frame rate and latency of the airway view. */
export interface Pace {
  /** Frame rate during the last movement, pictures per second; null before the first movement. */
  readonly fps: number | null;
  /**
   * Time from the arrival of the latest drawn pose to the drawing of its picture, ms; null before the first picture.
   */
  readonly ageMs: number | null;
  /** Time for which the latest pose has waited for its picture, ms; 0 while the picture shows the latest pose. */
  readonly waitingMs: number;
}

/** Frame rate and latency before the first picture. */
export const NO_PACE: Pace = { fps: null, ageMs: null, waitingMs: 0 };

/** Interval between two pictures, ms, above which they do not belong to the same movement. */
const PAUSE_MS = 400;
/** Weight of the latest interval in the exponential average of the intervals between pictures. */
const SMOOTHING = 0.15;
/** Number of poses without a picture above which the oldest one is deleted; it limits the memory. */
const MAX_POSES = 256;

/** Meter of the frame rate and the latency of the airway view. */
export class PaceMeter {
  readonly #arrivedMs = new Map<number, number>();
  #newestPose = -1;
  #shownPose = -1;
  #lastDrawMs: number | null = null;
  #gapMs: number | null = null;
  #ageMs: number | null = null;

  poseArrived(poseId: number, nowMs: number): void {
    if (this.#arrivedMs.has(poseId)) return;
    this.#newestPose = poseId;
    this.#arrivedMs.set(poseId, nowMs);
    if (this.#arrivedMs.size > MAX_POSES) {
      const [oldest] = this.#arrivedMs.keys();
      if (oldest !== undefined) this.#arrivedMs.delete(oldest);
    }
  }

  pictureDrawn(poseId: number, nowMs: number): void {
    const isNew = poseId !== this.#shownPose;
    this.#shownPose = poseId;
    const arrived = this.#arrivedMs.get(poseId);
    for (const known of [...this.#arrivedMs.keys()]) if (known < poseId) this.#arrivedMs.delete(known);
    // A finer picture of a pose that is already shown does not count for the frame rate.
    if (!isNew) return;
    if (arrived !== undefined) this.#ageMs = nowMs - arrived;
    const gap = this.#lastDrawMs === null ? null : nowMs - this.#lastDrawMs;
    this.#lastDrawMs = nowMs;
    if (gap === null || gap > PAUSE_MS) return;
    this.#gapMs = this.#gapMs === null ? gap : this.#gapMs + SMOOTHING * (gap - this.#gapMs);
  }

  /**
   * Record that a replacement picture shows a pose: the pose no longer waits for a picture, and the measurement
   * restarts.
   */
  placeholderDrawn(poseId: number): void {
    this.#shownPose = poseId;
    this.#lastDrawMs = null;
    this.#gapMs = null;
    this.#ageMs = null;
    for (const known of [...this.#arrivedMs.keys()]) if (known <= poseId) this.#arrivedMs.delete(known);
  }

  read(nowMs: number): Pace {
    const waitsSince = this.#shownPose === this.#newestPose ? undefined : this.#arrivedMs.get(this.#newestPose);
    return {
      fps: this.#gapMs === null ? null : Math.round(1000 / Math.max(this.#gapMs, 1)),
      ageMs: this.#ageMs === null ? null : Math.round(this.#ageMs),
      waitingMs: waitsSince === undefined ? 0 : Math.round(nowMs - waitsSince),
    };
  }

  reset(): void {
    this.#arrivedMs.clear();
    this.#newestPose = -1;
    this.#shownPose = -1;
    this.#lastDrawMs = null;
  }
}
