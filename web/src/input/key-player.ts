/**
 * Plays the flight through the key frames, or a recorded one: steered by time, once per screen refresh, as the automatic flight is steered by
 * place. Whoever else moves the tip takes over at once; the server says so with every pose. Time comes from outside.
 */

import { NOT_PLAYING, type Playing } from "../state/playing";
import type { ClientMessage, KeyFramesMessage, PoseMessage } from "../wire/messages";
import { MAX_TICK_S } from "./flight";

/** Nearer than this to a key frame or to the end, it is there. */
const AT_END_S = 0.02;

export interface PlayerSurroundings {
  /** 0 where there is no flight. */
  durationS(): number;
  /** Where a bar with steps is to stand exactly. */
  stops(): readonly number[];
  /** Brings the tip to a time; false without a connection. */
  fly(timeS: number, goesOn: boolean): boolean;
  /** The tip's time in this flight; null where anything else has moved it. */
  timeOf(pose: PoseMessage): number | null;
  /** The flight may have to be read first: time begins with the first answer. */
  readonly waits: boolean;
  changed(playing: Playing): void;
}

/** What a player of key frames stands on. */
export function keyFramesAround(
  keyFrames: () => KeyFramesMessage | null,
  send: (message: ClientMessage) => boolean,
  changed: (playing: Playing) => void,
): PlayerSurroundings {
  return {
    durationS: () => keyFrames()?.duration_s ?? 0,
    stops: () => (keyFrames()?.frames ?? []).map((key) => key.time_s),
    fly: (time_s, goes_on) => send({ type: "fly_key_frames", time_s, goes_on }),
    timeOf: (pose) => pose.key_frames_s,
    waits: false,
    changed,
  };
}

export class KeyPlayer {
  readonly #around: PlayerSurroundings;
  #playing = NOT_PLAYING;
  /** The server has answered: from now on a pose of another origin means that somebody took over. */
  #answered = false;

  constructor(around: PlayerSurroundings) {
    this.#around = around;
  }

  get isPlaying(): boolean {
    return this.#playing.on;
  }

  /** From where it is, or from the start where it is at the end; false where there is no flight. */
  play(): boolean {
    const lasts = this.#around.durationS();
    if (lasts <= 0) return false;
    const from = this.#playing.atS >= lasts - AT_END_S ? 0 : this.#playing.atS;
    if (!this.#go(from)) return false;
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

  /** Something could not be done: a flight that was not read by then may never begin. */
  refused(): void {
    if (!this.#answered) this.pause();
  }

  /** Another flight takes this one's place: it begins at its start. */
  begin(): void {
    this.#set({ on: false, atS: 0 });
  }

  /** Back to the start. */
  stop(): void {
    this.pause();
    this.seek(0);
  }

  seek(toS: number): void {
    const lasts = this.#around.durationS();
    const stops = [lasts, ...this.#around.stops()];
    // A bar has steps: what is meant is the key frame itself, or the end.
    const atS = stops.find((stop) => Math.abs(stop - toS) < AT_END_S) ?? Math.min(Math.max(toS, 0), lasts);
    if (lasts > 0 && this.#go(atS)) this.#set({ atS });
  }

  setRate(rate: number): void {
    this.#set({ rate });
  }

  tick(elapsedS: number): void {
    if (!this.#playing.on || (this.#around.waits && !this.#answered)) return;
    const lasts = this.#around.durationS();
    const atS = Math.min(this.#playing.atS + Math.min(elapsedS, MAX_TICK_S) * this.#playing.rate, lasts);
    this.#around.fly(atS, true);
    this.#set({ atS, on: atS < lasts });
  }

  /** The tip is where the server says; on the flight, the bar stands there too. */
  poseArrived(pose: PoseMessage): void {
    const timeS = this.#around.timeOf(pose);
    if (timeS !== null) {
      this.#answered = true;
      if (!this.#playing.on && timeS !== this.#playing.atS) this.#set({ atS: timeS });
    } else if (this.#answered) {
      this.pause();
    }
  }

  /** The flight was changed, another case was opened, or the connection is gone. */
  reset(lasts: number): void {
    if (this.#playing.on || this.#playing.atS > lasts) {
      this.#set({ on: false, atS: Math.min(this.#playing.atS, lasts) });
    }
  }

  #go(time_s: number): boolean {
    this.#answered = false;
    return this.#around.fly(time_s, false);
  }

  #set(change: Partial<Playing>): void {
    this.#playing = { ...this.#playing, ...change };
    this.#around.changed(this.#playing);
  }
}
