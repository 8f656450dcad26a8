/** A place for one HID device: asked for by a click, lost when it is pulled out, and back when it is plugged in again. */

import type { HidCollection } from "./hid";

/** What of the browser's `HIDDevice` is used. */
export interface HidDevice extends EventTarget {
  readonly vendorId: number;
  readonly productId: number;
  readonly productName: string;
  readonly opened: boolean;
  readonly collections: readonly HidCollection[];
  open(): Promise<void>;
  close(): Promise<void>;
}

export interface Hid extends EventTarget {
  requestDevice(options: { filters: readonly object[] }): Promise<readonly HidDevice[]>;
}

export interface InputReport extends Event {
  readonly reportId: number;
  readonly data: DataView;
}

/** Reads one device. */
export interface HidReader {
  readonly name: string;
  /** Why it cannot be used, in words. */
  readonly problem: string | null;
  open(): Promise<void>;
  close(): Promise<void>;
  /** Once per refresh. */
  tick(): void;
}

export interface HidPortSurroundings {
  gone(name: string): void;
  failed(words: string): void;
}

export class HidPort {
  readonly #hid: Hid;
  readonly #filters: readonly object[];
  readonly #read: (device: HidDevice) => HidReader;
  readonly #around: HidPortSurroundings;
  #device: HidDevice | null = null;
  #reader: HidReader | null = null;
  /** What is being opened; the newest counts. */
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

  /** The browser asks which device; needs a click. */
  async ask(): Promise<void> {
    try {
      // A device of several interfaces is handed on as several, of which one is what was asked for.
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
        // Another one was taken, or the page was left, while it was opened.
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
    // Browsers may hand out another object for the same device.
    if (device === undefined || before === null || this.#reader !== null) return;
    if (device.vendorId !== before.vendorId || device.productId !== before.productId) return;
    // Another interface of the same device.
    if (this.#read(device).problem !== null) return;
    this.#take(device).catch((trouble) => this.#fail(trouble));
  };

  #fail(trouble: unknown): void {
    // A DOMException is no Error everywhere.
    const why = trouble instanceof DOMException || trouble instanceof Error ? trouble.message : "";
    this.#around.failed(`The device could not be opened: ${why.replace(/\.$/, "") || "access was denied"}.`);
  }
}
