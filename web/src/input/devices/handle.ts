/** Scope handle connected by WebHID (`docs/scope-handle.md`): insertion, roll and lever. */

import type { ClientMessage } from "../../wire/messages";
import { buttonBit, type HidField, isButton, readField } from "./hid";
import type { HidDevice } from "./hid-port";
import { FieldReader } from "./hid-reader";

/** Vendor-defined HID usage page of the handle, so that no other software treats the handle as a mouse or a gamepad. */
const PAGE = 0xff42;
/** Filters that restrict the browser's device selection to scope handles. */
export const HANDLE_FILTERS = [{ usagePage: PAGE, usage: 0x01 }];
const CLOCK = PAGE * 0x10000 + 0x21;
const INSERTION = PAGE * 0x10000 + 0x22;
const ROLL = PAGE * 0x10000 + 0x23;
const LEVER = PAGE * 0x10000 + 0x24;
/** Time in ms at which the clock of the handle overflows and starts again at 0. */
const CLOCK_WRAPS_MS = 2 ** 31;
/** Insertion per unit of the report, mm. */
const MM = 0.01;
/** Roll per unit of the report, rad. */
const RAD = (0.01 * Math.PI) / 180;

interface Values {
  timeS: number;
  handle: readonly [number, number, number];
  buttons: number;
}

/** Reader that converts the reports of a scope handle to device samples. */
export class Handle extends FieldReader {
  readonly #send: (message: ClientMessage) => void;
  readonly #nowS: () => number;
  readonly #bad: () => void;
  #latest: Values | null = null;
  #clockMs: number | null = null;
  #wraps = 0;
  numBad = 0;

  /** Create the reader; `bad` is called once, at the first report that does not match the descriptor. */
  constructor(device: HidDevice, send: (message: ClientMessage) => void, nowS: () => number, bad: () => void) {
    super("scope handle", device);
    this.#send = send;
    this.#nowS = nowS;
    this.#bad = bad;
  }

  get problem(): string | null {
    const usages = [...this.fields.values()].map((fields) => fields.map((field) => field.usage));
    const whole = usages.some((report) => [INSERTION, ROLL, LEVER].every((usage) => report.includes(usage)));
    return whole ? null : "it does not send insertion, roll and lever in one report (see docs/scope-handle.md)";
  }

  tick(): void {
    const latest = this.#latest;
    this.#latest = null;
    if (latest === null) return;
    this.#send({
      type: "device_sample",
      device: this.name,
      time_s: latest.timeS,
      position_mm: null,
      orientation_wxyz: null,
      axes: null,
      buttons: latest.buttons,
      handle: latest.handle,
      advance: 0,
    });
  }

  protected received(fields: readonly HidField[], data: DataView): void {
    // Ignore reports without the insertion, because the device also sends reports that do not belong to the handle.
    if (!fields.some((field) => field.usage === INSERTION)) return;
    const values = this.#values(fields, data);
    if (values === null) {
      this.numBad += 1;
      if (this.numBad === 1) this.#bad();
    } else this.#latest = values;
  }

  #values(fields: readonly HidField[], data: DataView): Values | null {
    const found = new Map<number, number>();
    let buttons = 0;
    for (const field of fields) {
      const value = readField(data, field);
      // By the HID specification, a value outside the descriptor's range states that the device has no value.
      if (value === null || value < field.minimum || value > field.maximum) return null;
      if (isButton(field.usage)) buttons |= buttonBit(field, value);
      else found.set(field.usage, field.usage === LEVER ? value / Math.max(field.maximum, -field.minimum) : value);
    }
    const [insertion, roll, lever] = [found.get(INSERTION), found.get(ROLL), found.get(LEVER)];
    if (insertion === undefined || roll === undefined || lever === undefined) return null;
    // The lever has no finite position if its range in the descriptor is empty.
    if (!Number.isFinite(lever)) return null;
    return { timeS: this.#timeS(found.get(CLOCK)), handle: [insertion * MM, roll * RAD, lever], buttons };
  }

  /**
   * Return the time of a report, s: the handle's clock without wrap-around, or the page's clock if the handle has none.
   */
  #timeS(clockMs: number | undefined): number {
    if (clockMs === undefined) return this.#nowS();
    if (this.#clockMs !== null && this.#clockMs - clockMs > CLOCK_WRAPS_MS / 2) this.#wraps += 1;
    this.#clockMs = clockMs;
    return (clockMs + this.#wraps * CLOCK_WRAPS_MS) / 1000;
  }
}
