/**
 * Steering of the tip by held keys, wheel and drags, sent once per display refresh, and the automatic flight to the
 * next fork. The caller passes the elapsed time, so that tests need not wait.
 */

import { nextStopMm } from "../state/route";
import type { ClientMessage, RouteInfo } from "../wire/messages";
import type { HoldAxis } from "./keymap";

/** Speed of the tip while a movement key is held, mm/s; the trachea takes about four seconds. */
export const SPEED_MM_S = 25;
/** Factor by which the speed is multiplied while Shift is held. */
export const SLOW = 0.3;
/** Angular speed of the view while a turn key is held, rad/s. */
export const TURN_RAD_S = 1.0;
/** Advance of the tip per px of scrolling, mm; one notch of a common wheel is 100 px. */
export const WHEEL_MM_PER_PX = 0.03;
/**
 * Maximum time step of the movement, s, so that a late display refresh (another tab, a pause) does not move the tip
 * through a wall.
 */
export const MAX_TICK_S = 0.1;

/** Page functions that {@link Steering} uses; tests supply fakes. */
export interface SteeringHooks {
  route(): RouteInfo | null;
  pathMm(): number | null;
  /** Return the speed of the automatic flight, mm/s. */
  speedMmS(): number;
  send(message: ClientMessage): void;
  /** Called when the automatic flight starts or ends. */
  advancing(on: boolean): void;
}

/** Steering of the tip by keys and mouse. */
export class Steering {
  readonly #hooks: SteeringHooks;
  readonly #held: Record<HoldAxis, Set<1 | -1>> = {
    advance: new Set(),
    roll: new Set(),
    pitch: new Set(),
    yaw: new Set(),
  };
  /** Deflection of the sticks of the flight pad, -1 to 1. */
  readonly #sticks: Record<HoldAxis, number> = { advance: 0, roll: 0, pitch: 0, yaw: 0 };
  #slow = false;
  #pending = { advance_mm: 0, yaw_rad: 0, pitch_rad: 0, roll_rad: 0 };
  #auto: { atMm: number; stopMm: number } | null = null;

  constructor(hooks: SteeringHooks) {
    this.#hooks = hooks;
  }

  hold(axis: HoldAxis, sign: 1 | -1, down: boolean): void {
    if (down) this.#held[axis].add(sign);
    else this.#held[axis].delete(sign);
    if (down && axis === "advance") this.stopAuto();
  }

  /** Set the deflection of a stick of the flight pad, -1 to 1; the tip moves until the stick is back at 0. */
  stick(axis: HoldAxis, deflection: number): void {
    this.#sticks[axis] = Math.min(Math.max(deflection, -1), 1);
    if (deflection !== 0 && axis === "advance") this.stopAuto();
  }

  slow(on: boolean): void {
    this.#slow = on;
  }

  /** Add a movement of mouse or wheel, which is sent at the next display refresh. */
  nudge(move: Partial<{ advance_mm: number; yaw_rad: number; pitch_rad: number; roll_rad: number }>): void {
    if (move.advance_mm !== undefined) this.stopAuto();
    this.#pending.advance_mm += move.advance_mm ?? 0;
    this.#pending.yaw_rad += move.yaw_rad ?? 0;
    this.#pending.pitch_rad += move.pitch_rad ?? 0;
    this.#pending.roll_rad += move.roll_rad ?? 0;
  }

  /** Whether a key is held, movement waits to be sent, or the automatic flight runs. */
  get isMoving(): boolean {
    const isStick = Object.values(this.#sticks).some((deflection) => deflection !== 0);
    const isHeld = isStick || Object.values(this.#held).some((signs) => signs.size > 0);
    return isHeld || this.#auto !== null || Object.values(this.#pending).some((amount) => amount !== 0);
  }

  get isAuto(): boolean {
    return this.#auto !== null;
  }

  /** Start the automatic flight to the next fork of the route; return false if no route is ahead of the tip. */
  startAuto(): boolean {
    const route = this.#hooks.route();
    const at = this.#hooks.pathMm();
    if (route === null || at === null) return false;
    const stopMm = nextStopMm(route, at);
    if (stopMm - at < 0.05) return false;
    this.#auto = { atMm: at, stopMm };
    this.#hooks.advancing(true);
    return true;
  }

  stopAuto(): void {
    if (this.#auto === null) return;
    this.#auto = null;
    this.#hooks.advancing(false);
  }

  tick(elapsedS: number): void {
    const dt = Math.min(elapsedS, MAX_TICK_S);
    const pace = this.#slow ? SLOW : 1;
    const turn = TURN_RAD_S * pace * dt;
    this.#pending.advance_mm += this.#direction("advance") * SPEED_MM_S * pace * dt;
    this.#pending.yaw_rad += this.#direction("yaw") * turn;
    this.#pending.pitch_rad += this.#direction("pitch") * turn;
    this.#pending.roll_rad += this.#direction("roll") * turn;
    const move = this.#pending;
    if (move.advance_mm !== 0 || move.yaw_rad !== 0 || move.pitch_rad !== 0 || move.roll_rad !== 0) {
      this.#pending = { advance_mm: 0, yaw_rad: 0, pitch_rad: 0, roll_rad: 0 };
      this.#hooks.send({ type: "steer", ...move });
    }
    if (this.#auto !== null) {
      this.#auto.atMm = Math.min(this.#auto.atMm + this.#hooks.speedMmS() * pace * dt, this.#auto.stopMm);
      // Send positions, not speeds, so that the tip stops exactly at the fork whatever the latency is.
      this.#hooks.send({ type: "go_to", path_mm: this.#auto.atMm });
      if (this.#auto.atMm >= this.#auto.stopMm) this.stopAuto();
    }
  }

  #direction(axis: HoldAxis): number {
    let sum = this.#sticks[axis];
    for (const sign of this.#held[axis]) sum += sign;
    return sum;
  }
}
