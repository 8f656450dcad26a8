/** What readers of HID devices share: the device opened and closed, its reports taken apart by their descriptor. */

import { fieldsOf, type HidField } from "./hid";
import type { HidDevice, HidReader, InputReport } from "./hid-port";

const NAME_LENGTH = 200;

export abstract class FieldReader implements HidReader {
  readonly #device: HidDevice;
  /** Of each report, by its number. */
  protected readonly fields: ReadonlyMap<number, readonly HidField[]>;
  readonly name: string;

  constructor(kind: string, device: HidDevice) {
    this.#device = device;
    this.fields = fieldsOf(device.collections);
    this.name = `${kind} ${device.productName}`.slice(0, NAME_LENGTH);
  }

  abstract get problem(): string | null;

  abstract tick(): void;

  /** A report that the descriptor knows. */
  protected abstract heard(fields: readonly HidField[], data: DataView): void;

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
    if (fields !== undefined) this.heard(fields, data);
  };
}
