/** How quickly pictures follow, measured where they are seen: from a pose's arrival to the drawing of its picture. */

export interface Pace {
  /** Frame rate of the airway view during the last movement; null before the first one. */
  readonly fps: number | null;
  /** From the newest drawn pose's arrival to its picture; null before the first one. */
  readonly ageMs: number | null;
  /** How long the newest pose has been waiting for its picture; 0 while the picture is the newest. */
  readonly waitingMs: number;
}

export const NO_PACE: Pace = { fps: null, ageMs: null, waitingMs: 0 };

/** Pictures further apart than this do not belong to one movement. */
const PAUSE_MS = 400;
const SMOOTHING = 0.15;
/** Poses that no picture has answered yet; more would only be a leak. */
const MAX_POSES = 256;

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
    // The finer picture of a pose that is already shown is no news about how quickly pictures follow.
    if (!isNew) return;
    if (arrived !== undefined) this.#ageMs = nowMs - arrived;
    const gap = this.#lastDrawMs === null ? null : nowMs - this.#lastDrawMs;
    this.#lastDrawMs = nowMs;
    if (gap === null || gap > PAUSE_MS) return;
    this.#gapMs = this.#gapMs === null ? gap : this.#gapMs + SMOOTHING * (gap - this.#gapMs);
  }

  /** Another picture stands in for this pose: it is answered, and none of this view's pictures was drawn. */
  standInDrawn(poseId: number): void {
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
