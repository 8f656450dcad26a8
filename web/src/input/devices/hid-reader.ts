/** Base class of HID device readers: opens and closes the device, and decodes its reports by the report descriptor. */

import { fieldsOf, type HidField } from "./hid";
import type { HidDevice, HidReader, InputReport } from "./hid-port";

/** Maximum number of characters of a device's name. */
const NAME_LENGTH = 200;

/** Reader that decodes the reports of a HID device into fields; a subclass interprets the fields. */
export abstract class FieldReader implements HidReader {
  readonly #device: HidDevice;
  /** Fields of each input report, by report ID. */
  protected readonly fields: ReadonlyMap<number, readonly HidField[]>;
  readonly name: string;

  constructor(kind: string, device: HidDevice) {
    this.#device = device;
    this.fields = fieldsOf(device.collections);
    this.name = `${kind} ${device.productName}`.slice(0, NAME_LENGTH);
  }

  abstract get problem(): string | null;

  abstract tick(): void;

  /** Handle the fields and the bytes of a received report whose ID the descriptor defines. */
  protected abstract received(fields: readonly HidField[], data: DataView): void;

  async open(): Promise<void> {
    this.#device.addEventListener("inputreport", this.#report);
    if (!this.#device.opened) await this.#device.open();
  }

  async close(): Promise<void> {
    this.#device.removeEventListener("inputreport", this.#report);
    await this.#device.close();
  }

  readonly #report = (event: Event): void => {
    const { reportId, data } = event as InputReport;
    const fields = this.fields.get(reportId);
    if (fields !== undefined) this.received(fields, data);
  };
}
