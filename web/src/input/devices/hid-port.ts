/**
 * Connection to one HID device. The user selects the device by a click; the port closes the device when it is unplugged
 * and reopens it when it is plugged in again.
 */

import type { HidCollection } from "./hid";

/** The part of the browser's `HIDDevice` that Carina uses. */
export interface HidDevice extends EventTarget {
  readonly vendorId: number;
  readonly productId: number;
  readonly productName: string;
  readonly opened: boolean;
  readonly collections: readonly HidCollection[];
  open(): Promise<void>;
  close(): Promise<void>;
}

/** The part of the browser's `navigator.hid` that Carina uses. */
export interface Hid extends EventTarget {
  requestDevice(options: { filters: readonly object[] }): Promise<readonly HidDevice[]>;
}

/** The browser's event for an input report of a device. */
export interface InputReport extends Event {
  readonly reportId: number;
  readonly data: DataView;
}

/** Reader of the reports of one device, which sends their values. */
export interface HidReader {
  readonly name: string;
  /** Reason why the device cannot be used, as text for the user; null if the device can be used. */
  readonly problem: string | null;
  open(): Promise<void>;
  close(): Promise<void>;
  /** Send the current values of the device; call it once per display refresh. */
  tick(): void;
}

/** Callbacks of a {@link HidPort}. */
export interface HidPortHooks {
  disconnected(name: string): void;
  failed(words: string): void;
}

/** Connection to one HID device, from its selection until the port is stopped. */
export class HidPort {
  readonly #hid: Hid;
  readonly #filters: readonly object[];
  readonly #read: (device: HidDevice) => HidReader;
  readonly #hooks: HidPortHooks;
  #device: HidDevice | null = null;
  #reader: HidReader | null = null;
  /** The device that is being opened; null if none is. A device that is selected meanwhile replaces it. */
  #taking: { readonly device: HidDevice } | null = null;
  #stopped = false;

  constructor(hid: Hid, filters: readonly object[], read: (device: HidDevice) => HidReader, hooks: HidPortHooks) {
    this.#hid = hid;
    this.#filters = filters;
    this.#read = read;
    this.#hooks = hooks;
    hid.addEventListener("disconnect", this.#pulledOut);
    hid.addEventListener("connect", this.#pluggedIn);
  }

  get name(): string | null {
    return this.#reader?.name ?? null;
  }

  /**
   * Show the browser's device selection, and open the selected device. Browsers permit the selection only in response
   * to a click.
   */
  async selectDevice(): Promise<void> {
    try {
      // Browsers list each interface of a device as a separate device; use the interface that the reader supports.
      const devices = await this.#hid.requestDevice({ filters: this.#filters });
      const device = devices.find((one) => this.#read(one).problem === null) ?? devices[0];
      if (device !== undefined) await this.#open(device);
    } catch (trouble) {
      this.#fail(trouble);
    }
  }

  tick(): void {
    this.#reader?.tick();
  }

  async stop(): Promise<void> {
    this.#hid.removeEventListener("disconnect", this.#pulledOut);
    this.#hid.removeEventListener("connect", this.#pluggedIn);
    this.#stopped = true;
    this.#device = null;
    this.#taking = null;
    await this.#release();
  }

  async #open(device: HidDevice): Promise<void> {
    if (this.#stopped || this.#taking?.device === device) return;
    const reader = this.#read(device);
    if (reader.problem !== null) {
      this.#hooks.failed(`${device.productName} cannot be used: ${reader.problem}.`);
      return;
    }
    const taking = { device };
    this.#taking = taking;
    try {
      await this.#release();
      await reader.open();
      if (this.#taking !== taking) {
        // Close the device again: another device was selected, or the port was stopped, while the device was being
        // opened.
        await reader.close().catch(() => undefined);
        return;
      }
      this.#device = device;
      this.#reader = reader;
    } finally {
      if (this.#taking === taking) this.#taking = null;
    }
  }

  async #release(): Promise<void> {
    const reader = this.#reader;
    this.#reader = null;
    if (reader === null) return;
    this.#hooks.disconnected(reader.name);
    await reader.close().catch(() => undefined);
  }

  readonly #pulledOut = (event: Event): void => {
    if (this.#device !== null && (event as Event & { device?: unknown }).device === this.#device) void this.#release();
  };

  readonly #pluggedIn = (event: Event): void => {
    const { device } = event as Event & { device?: HidDevice };
    const before = this.#device;
    // Compare devices by vendor and product, because a browser may use a new object for the same device.
    if (device === undefined || before === null || this.#reader !== null) return;
    if (device.vendorId !== before.vendorId || device.productId !== before.productId) return;
    // The reader cannot use this object, which is another interface of the same device.
    if (this.#read(device).problem !== null) return;
    this.#open(device).catch((trouble) => this.#fail(trouble));
  };

  #fail(trouble: unknown): void {
    // In some environments a DOMException is not an Error.
    const why = trouble instanceof DOMException || trouble instanceof Error ? trouble.message : "";
    this.#hooks.failed(`The device could not be opened: ${why.replace(/\.$/, "") || "access was denied"}.`);
  }
}
