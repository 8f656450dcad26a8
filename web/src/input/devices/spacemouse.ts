/** SpaceMouse connected by WebHID: its cap moves and rotates the tip in six degrees of freedom. */

import type { ClientMessage } from "../../wire/messages";
import { type SixAxes, shaped } from "./gamepad";
import { AXIS_USAGES, buttonBit, type HidField, isButton, readField, scaled } from "./hid";
import type { HidDevice } from "./hid-port";
import { FieldReader } from "./hid-reader";

/** Filters of the browser's device selection by vendor: 3Dconnexion, and Logitech for older models. */
export const SPACEMOUSE_FILTERS = [{ vendorId: 0x256f }, { vendorId: 0x046d, usagePage: 0x01, usage: 0x08 }];

/**
 * Convert the axes of the cap (X right, Y towards the user, Z down, and a rotation about each) to the six axes of the
 * tip.
 */
export function capAxes(values: readonly number[]): SixAxes {
  const at = (n: number) => shaped(values[n] ?? 0);
  return [-at(1) + 0, at(0) + 0, -at(2) + 0, at(5) + 0, -at(3) + 0, -at(4) + 0];
}

/** Reader that converts the reports of a SpaceMouse to device samples. */
export class SpaceMouse extends FieldReader {
  readonly #send: (message: ClientMessage) => void;
  readonly #nowS: () => number;
  /** Latest value of each axis of the cap; translation and rotation arrive in separate reports. */
  readonly #values = [0, 0, 0, 0, 0, 0];
  #buttons = 0;
  #rests = true;

  constructor(device: HidDevice, send: (message: ClientMessage) => void, nowS: () => number) {
    super("spacemouse", device);
    this.#send = send;
    this.#nowS = nowS;
  }

  get problem(): string | null {
    const some = [...this.fields.values()].flat().some((field) => axisOf(field) >= 0);
    return some ? null : "it reports no movement axes";
  }

  /**
   * Send the latest values while the cap is deflected or a button is held, and the rest position once; call it once per
   * display refresh. The call rate limits the rate of samples, because the device sends more reports.
   */
  tick(): void {
    const axes = capAxes(this.#values);
    const rests = axes.every((value) => value === 0) && this.#buttons === 0;
    if (rests && this.#rests) return;
    this.#rests = rests;
    this.#send({
      type: "device_sample",
      device: this.name,
      time_s: this.#nowS(),
      position_mm: null,
      orientation_wxyz: null,
      axes,
      buttons: this.#buttons,
      handle: null,
      advance: 0,
    });
  }

  protected received(fields: readonly HidField[], data: DataView): void {
    let buttons: number | null = null;
    for (const field of fields) {
      const value = readField(data, field);
      if (value === null) continue;
      const axis = axisOf(field);
      if (axis >= 0) this.#values[axis] = scaled(value, field);
      else if (isButton(field.usage)) buttons = (buttons ?? 0) | buttonBit(field, value);
    }
    if (buttons !== null) this.#buttons = buttons;
  }
}

function axisOf(field: HidField): number {
  return AXIS_USAGES.indexOf(field.usage as (typeof AXIS_USAGES)[number]);
}
