/**
 * Gamepads: sticks and triggers move the tip, buttons run actions of keys, and the gamepad vibrates when the tip
 * touches the wall.
 */

import type { ClientMessage } from "../../wire/messages";
import type { Action } from "../keymap";

/** Values of the six axes of a device: three translations, then three rotations, each -1 to 1. */
export type SixAxes = readonly [number, number, number, number, number, number];

/** The fields of the browser's `Gamepad` that Carina reads. */
export interface Pad {
  readonly index: number;
  readonly id: string;
  readonly connected: boolean;
  readonly mapping: string;
  readonly axes: readonly number[];
  readonly buttons: readonly { readonly pressed: boolean; readonly value: number }[];
  readonly vibrationActuator?: { playEffect?(kind: string, effect: object): Promise<unknown> } | null;
}

/** Browser and page functions that {@link Gamepads} uses; tests supply fakes. */
export interface PadHooks {
  pads(): readonly (Pad | null)[];
  nowS(): number;
  send(message: ClientMessage): void;
  act(action: Action): void;
  enabled(): boolean;
}

/** Dead zone of a stick, as a fraction of its travel: worn sticks rest at up to this value. */
const DEAD = 0.12;
/** Actions of the buttons, by button index in the browser's standard mapping. */
const BUTTON_ACTIONS: ReadonlyMap<number, Action> = new Map([
  [0, "auto_advance"],
  [1, "previous_fork"],
  [2, "level_horizon"],
  [3, "toggle_mode"],
  [8, "reset_look"],
  [14, "way_left"],
  [15, "way_right"],
]);
/** Index, in the browser's standard mapping, of the trigger that withdraws the tip. */
const WITHDRAW = 6;
/** Index, in the browser's standard mapping, of the trigger that advances the tip. */
const ADVANCE = 7;

/**
 * Return the response to a stick position: 0 inside the dead zone, then continuous and finer near the centre (half of
 * the travel gives a quarter of the speed).
 */
export function shaped(value: number): number {
  if (!Number.isFinite(value)) return 0;
  const beyond = (Math.min(Math.abs(value), 1) - DEAD) / (1 - DEAD);
  return beyond <= 0 ? 0 : Math.sign(value) * beyond * beyond;
}

/**
 * Return the six axes of a gamepad. The left stick advances and rolls, the right stick turns the view, and the triggers
 * withdraw and advance.
 */
export function padAxes(pad: Pad): SixAxes {
  const stick = (n: number) => shaped(pad.axes[n] ?? 0);
  const trigger = (n: number) => shaped(pad.buttons[n]?.value ?? 0);
  const forward = Math.max(-1, Math.min(1, -stick(1) + trigger(ADVANCE) - trigger(WITHDRAW)));
  // Adding 0 converts -0 to 0, because the protocol does not accept -0.
  return [forward + 0, 0, 0, stick(2) + 0, -stick(3) + 0, stick(0) + 0];
}

/** All connected gamepads, with the button and stick states that were sent last. */
export class Gamepads {
  readonly #hooks: PadHooks;
  readonly #moving = new Set<number>();
  readonly #pressed = new Map<number, ReadonlySet<number>>();
  readonly #names = new Map<number, string>();

  constructor(hooks: PadHooks) {
    this.#hooks = hooks;
  }

  /** Names of the connected gamepads, as shown in the panel of devices. */
  get names(): readonly string[] {
    return [...this.#names.values()];
  }

  /**
   * Send the current state of each gamepad that is deflected or has just returned to rest; call it once per display
   * refresh.
   */
  tick(): void {
    const pads = this.#hooks.pads().filter((pad): pad is Pad => pad?.connected === true);
    for (const [index, name] of this.#names) {
      if (pads.some((pad) => pad.index === index)) continue;
      this.#names.delete(index);
      this.#moving.delete(index);
      this.#pressed.delete(index);
      this.#hooks.send({ type: "device_gone", device: name });
    }
    for (const pad of pads) {
      const name = `gamepad ${pad.index + 1}: ${pad.id}`.slice(0, 200);
      this.#names.set(pad.index, name);
      if (this.#hooks.enabled()) this.#read(pad, name);
    }
  }

  /** Vibrate every gamepad that supports it. */
  rumble(strength: number, ms: number): void {
    for (const pad of this.#hooks.pads()) {
      const effect = { duration: ms, strongMagnitude: strength, weakMagnitude: strength };
      pad?.vibrationActuator?.playEffect?.("dual-rumble", effect).catch(() => undefined);
    }
  }

  #read(pad: Pad, name: string): void {
    const axes = padAxes(pad);
    const rests = axes.every((value) => value === 0);
    // Send the rest position of a gamepad once, and nothing while it stays at rest.
    if (!rests || this.#moving.has(pad.index)) {
      this.#hooks.send({
        type: "device_sample",
        device: name,
        time_s: this.#hooks.nowS(),
        position_mm: null,
        orientation_wxyz: null,
        axes,
        buttons: 0,
        handle: null,
        advance: 0,
      });
    }
    if (rests) this.#moving.delete(pad.index);
    else this.#moving.add(pad.index);
    const before = this.#pressed.get(pad.index);
    const now = new Set(pad.buttons.flatMap((button, n) => (button.pressed ? [n] : [])));
    this.#pressed.set(pad.index, now);
    // Ignore buttons that were already pressed when the gamepad was first seen, and gamepads with an unknown button
    // order.
    if (before === undefined || pad.mapping !== "standard") return;
    for (const n of now) {
      const action = BUTTON_ACTIONS.get(n);
      if (action !== undefined && !before.has(n)) this.#hooks.act(action);
    }
  }
}
