/**
 * Playback of the flight through the key frames, or of a recorded flight: sends a position in time once per display
 * refresh. Movement of the tip by any other input stops the playback; the server reports the origin of each pose. The
 * caller passes the elapsed time.
 */

import { NOT_PLAYING, type Playing } from "../state/playing";
import type { ClientMessage, KeyFramesMessage, PoseMessage } from "../wire/messages";
import { MAX_TICK_S } from "./steering";

/** Maximum time difference, s, between a slider position and a key frame, or the flight's end, that count as equal. */
const AT_END_S = 0.02;

/** Functions of the flight that a {@link KeyPlayer} plays. */
export interface PlayerHooks {
  /** Return the duration of the flight, s; 0 without a flight. */
  durationS(): number;
  /** Return the times, s, to which the position slider snaps. */
  stops(): readonly number[];
  /** Move the tip to the flight's position at a time; return false without a connection. */
  fly(timeS: number, continues: boolean): boolean;
  /** Return the time of a pose in this flight, s; null if another input moved the tip. */
  timeOf(pose: PoseMessage): number | null;
  /** Whether playback starts only after the server's first answer, because the server may have to load the flight. */
  readonly waits: boolean;
  changed(playing: Playing): void;
}

/** Return the functions with which a {@link KeyPlayer} plays the flight through the key frames. */
export function keyFrameHooks(
  keyFrames: () => KeyFramesMessage | null,
  send: (message: ClientMessage) => boolean,
  changed: (playing: Playing) => void,
): PlayerHooks {
  return {
    durationS: () => keyFrames()?.duration_s ?? 0,
    stops: () => (keyFrames()?.frames ?? []).map((key) => key.time_s),
    fly: (time_s, goes_on) => send({ type: "fly_key_frames", time_s, goes_on }),
    timeOf: (pose) => pose.key_frames_s,
    waits: false,
    changed,
  };
}

/** Player of a flight along key frames or of a recorded flight: it sets the time of the pose. */
export class KeyPlayer {
  readonly #hooks: PlayerHooks;
  #playing = NOT_PLAYING;
  /**
   * Whether the server has answered the last command. After the answer, a pose of another origin stops the playback.
   */
  #answered = false;

  constructor(hooks: PlayerHooks) {
    this.#hooks = hooks;
  }

  get isPlaying(): boolean {
    return this.#playing.on;
  }

  /**
   * Start the playback at the current position, or at the beginning if the position is at the end. Return false without
   * a flight or a connection.
   */
  play(): boolean {
    const lasts = this.#hooks.durationS();
    if (lasts <= 0) return false;
    const from = this.#playing.atS >= lasts - AT_END_S ? 0 : this.#playing.atS;
    if (!this.#sendPosition(from)) return false;
    this.#set({ on: true, atS: from });
    return true;
  }

  pause(): void {
    if (this.#playing.on) this.#set({ on: false });
  }

  toggle(): boolean {
    if (!this.#playing.on) return this.play();
    this.pause();
    return true;
  }

  /** Stop the playback if the server reports an error before its first answer, because the flight may never start. */
  stopIfUnanswered(): void {
    if (!this.#answered) this.pause();
  }

  /** Select another flight: stop the playback and reset the position to the beginning. */
  resetToStart(): void {
    this.#set({ on: false, atS: 0 });
  }

  /** Stop the playback and move the tip to the beginning of the flight. */
  stop(): void {
    this.pause();
    this.seek(0);
  }

  seek(toS: number): void {
    const lasts = this.#hooks.durationS();
    const stops = [lasts, ...this.#hooks.stops()];
    // The slider has discrete steps. A position near a key frame or near the end selects that time exactly.
    const atS = stops.find((stop) => Math.abs(stop - toS) < AT_END_S) ?? Math.min(Math.max(toS, 0), lasts);
    if (lasts > 0 && this.#sendPosition(atS)) this.#set({ atS });
  }

  setRate(rate: number): void {
    this.#set({ rate });
  }

  tick(elapsedS: number): void {
    if (!this.#playing.on || (this.#hooks.waits && !this.#answered)) return;
    const lasts = this.#hooks.durationS();
    const atS = Math.min(this.#playing.atS + Math.min(elapsedS, MAX_TICK_S) * this.#playing.rate, lasts);
    this.#hooks.fly(atS, true);
    this.#set({ atS, on: atS < lasts });
  }

  /** Update the position from a pose of the flight; stop the playback after a pose of another origin. */
  poseArrived(pose: PoseMessage): void {
    const timeS = this.#hooks.timeOf(pose);
    if (timeS !== null) {
      this.#answered = true;
      if (!this.#playing.on && timeS !== this.#playing.atS) this.#set({ atS: timeS });
    } else if (this.#answered) {
      this.pause();
    }
  }

  /**
   * Stop the playback and limit its position to the new duration, after a change of the flight or the case, or after
   * the loss of the connection.
   */
  limitDuration(lasts: number): void {
    if (this.#playing.on || this.#playing.atS > lasts) {
      this.#set({ on: false, atS: Math.min(this.#playing.atS, lasts) });
    }
  }

  #sendPosition(time_s: number): boolean {
    this.#answered = false;
    return this.#hooks.fly(time_s, false);
  }

  #set(change: Partial<Playing>): void {
    this.#playing = { ...this.#playing, ...change };
    this.#hooks.changed(this.#playing);
  }
}
