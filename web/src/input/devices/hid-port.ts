/**
 * Connection to one HID device: the user selects the device by a click; the port closes it when it is unplugged and
 * reopens it when it is plugged in again.
 */

import type { HidCollection } from "./hid";

/** The part of the browser's `HIDDevice` that is used. */
export interface HidDevice extends EventTarget {
  readonly vendorId: number;
  readonly productId: number;
  readonly productName: string;
  readonly opened: boolean;
  readonly collections: readonly HidCollection[];
  open(): Promise<void>;
  close(): Promise<void>;
}

/** The part of the browser's `navigator.hid` that is used. */
export interface Hid extends EventTarget {
  requestDevice(options: { filters: readonly object[] }): Promise<readonly HidDevice[]>;
}

/** The browser's event of an input report. */
export interface InputReport extends Event {
  readonly reportId: number;
  readonly data: DataView;
}

/** Reader of one device. */
export interface HidReader {
  readonly name: string;
  /** The reason why the device cannot be used, as text; null if it can. */
  readonly problem: string | null;
  open(): Promise<void>;
  close(): Promise<void>;
  /** Send the current values; call it once per display refresh. */
  tick(): void;
}

/** Callbacks of a {@link HidPort}. */
export interface HidPortSurroundings {
  gone(name: string): void;
  failed(words: string): void;
}

/** Connection to one HID device. */
export class HidPort {
  readonly #hid: Hid;
  readonly #filters: readonly object[];
  readonly #read: (device: HidDevice) => HidReader;
  readonly #around: HidPortSurroundings;
  #device: HidDevice | null = null;
  #reader: HidReader | null = null;
  /** The device that is being opened; a later device replaces it. */
  #taking: { readonly device: HidDevice } | null = null;
  #stopped = false;

  constructor(
    hid: Hid,
    filters: readonly object[],
    read: (device: HidDevice) => HidReader,
    around: HidPortSurroundings,
  ) {
    this.#hid = hid;
    this.#filters = filters;
    this.#read = read;
    this.#around = around;
    hid.addEventListener("disconnect", this.#pulledOut);
    hid.addEventListener("connect", this.#pluggedIn);
  }

  get name(): string | null {
    return this.#reader?.name ?? null;
  }

  /** Show the browser's device selection; browsers require a click. */
  async ask(): Promise<void> {
    try {
      // The browser returns one device per interface; use the interface that the reader supports.
      const devices = await this.#hid.requestDevice({ filters: this.#filters });
      const device = devices.find((one) => this.#read(one).problem === null) ?? devices[0];
      if (device !== undefined) await this.#take(device);
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
    await this.#letGo();
  }

  async #take(device: HidDevice): Promise<void> {
    if (this.#stopped || this.#taking?.device === device) return;
    const reader = this.#read(device);
    if (reader.problem !== null) {
      this.#around.failed(`${device.productName} cannot be used: ${reader.problem}.`);
      return;
    }
    const taking = { device };
    this.#taking = taking;
    try {
      await this.#letGo();
      await reader.open();
      if (this.#taking !== taking) {
        // Another device was selected or the port was stopped while this device was opened.
        await reader.close().catch(() => undefined);
        return;
      }
      this.#device = device;
      this.#reader = reader;
    } finally {
      if (this.#taking === taking) this.#taking = null;
    }
  }

  async #letGo(): Promise<void> {
    const reader = this.#reader;
    this.#reader = null;
    if (reader === null) return;
    this.#around.gone(reader.name);
    await reader.close().catch(() => undefined);
  }

  readonly #pulledOut = (event: Event): void => {
    if (this.#device !== null && (event as Event & { device?: unknown }).device === this.#device) void this.#letGo();
  };

  readonly #pluggedIn = (event: Event): void => {
    const { device } = event as Event & { device?: HidDevice };
    const before = this.#device;
    // Compare by vendor and product, because browsers may use a new object for the same device.
    if (device === undefined || before === null || this.#reader !== null) return;
    if (device.vendorId !== before.vendorId || device.productId !== before.productId) return;
    // This is another interface of the same device.
    if (this.#read(device).problem !== null) return;
    this.#take(device).catch((trouble) => this.#fail(trouble));
  };

  #fail(trouble: unknown): void {
    // In some environments a DOMException is not an Error.
    const why = trouble instanceof DOMException || trouble instanceof Error ? trouble.message : "";
    this.#around.failed(`The device could not be opened: ${why.replace(/\.$/, "") || "access was denied"}.`);
  }
}
