import { readFileSync } from "node:fs";
import { beforeEach, describe, expect, it } from "vitest";
import type { ClientMessage, DeviceSampleMessage } from "../../wire/messages";
import { checkClientMessage } from "../../wire/parse";
import { HANDLE_FILTERS, Handle } from "./handle";
import type { HidCollection } from "./hid";
import { collectionsOf } from "./hid-descriptor.testing";
import { type Hid, type HidDevice, HidPort } from "./hid-port";

/** Return the report descriptor of the example firmware, byte by byte. */
function sketchDescriptor(): Uint8Array {
  const sketch = readFileSync(
    new URL("../../../../examples/03_scope_handle/scope_handle.ino", import.meta.url),
    "utf8",
  );
  const table = /REPORT_DESCRIPTOR\[\] PROGMEM = \{([\s\S]*?)\};/.exec(sketch)?.[1] ?? "";
  const bytes = table.replaceAll(/\/\/.*$/gm, "").match(/0x[0-9A-F]{2}/g) ?? [];
  return Uint8Array.from(bytes.map(Number));
}

class FakeDevice extends EventTarget implements HidDevice {
  readonly vendorId: number;
  readonly productId: number;
  readonly productName = "Test handle";
  readonly collections: readonly HidCollection[];
  opened = false;
  refuses = false;
  constructor(collections: readonly HidCollection[], vendorId = 0x2341, productId = 0x8036) {
    super();
    this.vendorId = vendorId;
    this.productId = productId;
    this.collections = collections;
  }
  open(): Promise<void> {
    if (this.refuses) return Promise.reject(new DOMException("it is open in another program", "NotAllowedError"));
    this.opened = true;
    return Promise.resolve();
  }
  close(): Promise<void> {
    this.opened = false;
    return Promise.resolve();
  }
  /** Send a report in the memory layout of the firmware's struct. */
  report(clockMs: number, insertion: number, roll: number, lever: number, buttons: number, bytes = 15): void {
    const data = new DataView(new ArrayBuffer(15));
    data.setUint32(0, clockMs, true);
    data.setInt32(4, insertion, true);
    data.setInt32(8, roll, true);
    data.setInt16(12, lever, true);
    data.setUint8(14, buttons);
    const cut = new DataView(data.buffer, 0, bytes);
    this.dispatchEvent(Object.assign(new Event("inputreport"), { reportId: 1, data: cut }));
  }
}

const SKETCH = collectionsOf(sketchDescriptor());
let sent: ClientMessage[];
let numBadReports: number;
let device: FakeDevice;
let handle: Handle;
const samples = () => sent.filter((message): message is DeviceSampleMessage => message.type === "device_sample");
const made = (of: HidDevice) =>
  new Handle(
    of,
    (message) => {
      checkClientMessage(JSON.stringify(message));
      sent.push(message);
    },
    () => 99,
    () => {
      numBadReports += 1;
    },
  );

beforeEach(async () => {
  sent = [];
  numBadReports = 0;
  device = new FakeDevice(SKETCH);
  handle = made(device);
  await handle.open();
});

describe("report descriptor of the example firmware", () => {
  it("The descriptor matches the browser's filter and defines all 15 bytes of the report.", () => {
    expect(SKETCH.map(({ usagePage, usage }) => ({ usagePage, usage }))).toEqual(HANDLE_FILTERS);
    expect(handle.problem).toBeNull();
    const bits = (SKETCH[0]?.inputReports?.[0]?.items ?? []).map(
      (item) => (item.reportSize ?? 0) * (item.reportCount ?? 0),
    );
    expect(bits.reduce((sum, n) => sum + n, 0)).toBe(15 * 8);
  });
});

describe("Handle", () => {
  it("A report is sent as insertion in mm, roll in rad, lever as a fraction, buttons and the handle's time.", () => {
    device.report(12_500, 12_345, -9_000, 500, 0b10);
    handle.tick();
    const [sample] = samples();
    expect(sample).toMatchObject({ device: "scope handle Test handle", time_s: 12.5, buttons: 2, axes: null });
    expect(sample?.handle?.[0]).toBeCloseTo(123.45, 9);
    expect(sample?.handle?.[1]).toBeCloseTo(-Math.PI / 2, 9);
    expect(sample?.handle?.[2]).toBe(0.5);
  });

  it("Of many reports between two refreshes only the latest is sent.", () => {
    for (let n = 0; n < 1000; n += 1) device.report(n, n, 0, 0, 0);
    handle.tick();
    handle.tick();
    expect(samples().map((sample) => sample.handle?.[0])).toEqual([9.99]);
  });

  it("The sample time continues when the handle's 31-bit clock wraps around.", () => {
    device.report(2 ** 31 - 10, 0, 0, 0, 0);
    handle.tick();
    device.report(6, 0, 0, 0, 0);
    handle.tick();
    const [before, after] = samples();
    expect((after?.time_s ?? 0) - (before?.time_s ?? 0)).toBeCloseTo(0.016, 6);
  });

  it("A small step back of the handle's clock is not taken for a wrap-around.", () => {
    device.report(2000, 0, 0, 0, 0);
    handle.tick();
    device.report(1990, 0, 0, 0, 0);
    handle.tick();
    expect(samples().map((sample) => sample.time_s)).toEqual([2, 1.99]);
  });

  it("Values out of range and truncated reports are counted and not sent, and the callback reports them once.", () => {
    device.report(1, 0, 0, 1500, 0);
    device.report(2, 2_000_000_000, 0, 0, 0);
    device.report(3, 0, 0, 0, 0, 9);
    device.report(2 ** 31 + 5, 0, 0, 0, 0);
    device.dispatchEvent(
      Object.assign(new Event("inputreport"), { reportId: 7, data: new DataView(new ArrayBuffer(2)) }),
    );
    handle.tick();
    expect([samples().length, handle.numBad, numBadReports]).toEqual([0, 4, 1]);
    device.report(5, 100, 0, -1000, 0);
    handle.tick();
    expect(samples()[0]?.handle).toEqual([1, 0, -1]);
  });

  it("Fields are found by their usages at other positions, sizes and ranges; without a clock the page's is used.", async () => {
    const field = (usage: number, reportSize: number, low: number, high: number) => ({
      usages: [0xff42 * 0x10000 + usage],
      reportSize,
      reportCount: 1,
      logicalMinimum: low,
      logicalMaximum: high,
    });
    const other = new FakeDevice([
      {
        usagePage: 0xff42,
        usage: 1,
        inputReports: [
          {
            reportId: 4,
            items: [field(0x24, 8, -128, 127), field(0x23, 16, -20_000, 20_000), field(0x22, 16, 0, 65_535)],
          },
        ],
      },
    ]);
    const small = made(other);
    await small.open();
    const data = new DataView(new ArrayBuffer(5));
    data.setInt8(0, -128);
    data.setInt16(1, 18_000, true);
    data.setUint16(3, 40_000, true);
    other.dispatchEvent(Object.assign(new Event("inputreport"), { reportId: 4, data }));
    small.tick();
    expect(samples()[0]).toMatchObject({ time_s: 99 });
    expect(samples()[0]?.handle?.[0]).toBeCloseTo(400, 9);
    expect(samples()[0]?.handle?.[1]).toBeCloseTo(Math.PI, 9);
    // The lever is scaled by the limit with the larger magnitude, here the lower one (-128).
    expect(samples()[0]?.handle?.[2]).toBe(-1);
  });

  it("A lever with an empty range is counted as invalid, and no sample is sent.", async () => {
    const field = (usage: number, high: number) => ({
      usages: [0xff42 * 0x10000 + usage],
      reportSize: 8,
      reportCount: 1,
      logicalMinimum: 0,
      logicalMaximum: high,
    });
    const stuck = new FakeDevice([
      { usagePage: 0xff42, usage: 1, inputReports: [{ items: [field(0x22, 100), field(0x23, 100), field(0x24, 0)] }] },
    ]);
    const still = made(stuck);
    await still.open();
    stuck.dispatchEvent(
      Object.assign(new Event("inputreport"), { reportId: 0, data: new DataView(new ArrayBuffer(3)) }),
    );
    still.tick();
    expect([samples().length, still.numBad, numBadReports]).toEqual([0, 1, 1]);
  });

  it("A descriptor whose single report lacks insertion, roll or lever is rejected with a message.", () => {
    const report = (reportId: number, ...usages: number[]) => ({
      reportId,
      items: usages.map((usage) => ({
        usages: [0xff42 * 0x10000 + usage],
        reportSize: 16,
        reportCount: 1,
        logicalMinimum: -1000,
        logicalMaximum: 1000,
      })),
    });
    const of = (...inputReports: ReturnType<typeof report>[]) =>
      made(new FakeDevice([{ usagePage: 0xff42, usage: 1, inputReports }])).problem;
    expect(of(report(1, 0x22, 0x23, 0x24))).toBeNull();
    expect(of()).toContain("insertion");
    expect(of(report(1, 0x22, 0x23))).toContain("insertion");
    expect(of(report(1, 0x22, 0x23), report(2, 0x24))).toContain("insertion");
  });
});

class FakeHid extends EventTarget implements Hid {
  offers: FakeDevice[] = [];
  requestDevice(): Promise<readonly HidDevice[]> {
    return Promise.resolve(this.offers);
  }
  event(name: "connect" | "disconnect", of: HidDevice): void {
    this.dispatchEvent(Object.assign(new Event(name), { device: of }));
  }
}

describe("HidPort", () => {
  let hid: FakeHid;
  let disconnected: string[];
  let failed: string[];
  let port: HidPort;
  const settled = () => new Promise((done) => setTimeout(done, 0));

  beforeEach(() => {
    hid = new FakeHid();
    [disconnected, failed] = [[], []];
    port = new HidPort(hid, HANDLE_FILTERS, made, {
      disconnected: (name) => disconnected.push(name),
      failed: (words) => failed.push(words),
    });
  });

  it("The port has no device until the user selects one, and then sends its samples.", async () => {
    await port.selectDevice();
    expect(port.name).toBeNull();
    hid.offers = [device];
    await port.selectDevice();
    expect(port.name).toBe("scope handle Test handle");
    device.report(1, 100, 0, 0, 0);
    port.tick();
    expect(samples().length).toBe(1);
  });

  it("An unplugged device leaves the port, and the port reopens it when it is plugged in again.", async () => {
    hid.offers = [device];
    await port.selectDevice();
    const another = new FakeDevice([]);
    hid.event("disconnect", another);
    expect(port.name).not.toBeNull();
    for (const back of [device, new FakeDevice(SKETCH)]) {
      hid.event("disconnect", device);
      await settled();
      expect([port.name, disconnected.length > 0]).toEqual([null, true]);
      for (const other of [new FakeDevice(SKETCH, 1), new FakeDevice(SKETCH, 0x2341, 1)]) {
        hid.event("connect", other);
        await settled();
        expect(port.name).toBeNull();
      }
      hid.event("connect", back);
      await settled();
      expect([port.name, back.opened]).toEqual(["scope handle Test handle", true]);
      sent = [];
      back.report(1, 100, 0, 0, 0);
      port.tick();
      expect(samples().length).toBe(1);
    }
    expect(disconnected).toEqual(["scope handle Test handle", "scope handle Test handle"]);
  });

  it("A second device that is plugged in does not replace the open device, but a selected one does.", async () => {
    hid.offers = [device];
    await port.selectDevice();
    const another = new FakeDevice(SKETCH);
    hid.event("connect", another);
    await settled();
    expect([device.opened, another.opened, disconnected]).toEqual([true, false, []]);
    hid.offers = [another];
    await port.selectDevice();
    expect([device.opened, another.opened, disconnected]).toEqual([false, true, ["scope handle Test handle"]]);
    device.report(1, 100, 0, 0, 0);
    port.tick();
    expect(samples()).toEqual([]);
  });

  it("A failure message states why a device is unusable or cannot be opened.", async () => {
    hid.offers = [new FakeDevice([])];
    await port.selectDevice();
    device.refuses = true;
    device.opened = false;
    hid.offers = [device];
    await port.selectDevice();
    expect(failed[0]).toContain("Test handle cannot be used: it does not send insertion");
    expect(failed[1]).toBe("The device could not be opened: it is open in another program.");
    expect(port.name).toBeNull();
  });

  it("Of several interfaces of a device the port opens the one with the controls, also after replugging.", async () => {
    const keys = new FakeDevice([]);
    hid.offers = [keys, device];
    await port.selectDevice();
    expect([port.name, failed]).toEqual(["scope handle Test handle", []]);
    hid.event("disconnect", device);
    await settled();
    // Browsers report the interfaces of a device one after the other.
    hid.event("connect", keys);
    hid.event("connect", device);
    await settled();
    expect([port.name, failed, keys.opened, device.opened]).toEqual(["scope handle Test handle", [], false, true]);
  });

  it("If a second device connects while the first is being opened, only the second one stays open.", async () => {
    hid.offers = [device];
    await port.selectDevice();
    hid.event("disconnect", device);
    await settled();
    const [first, second] = [new FakeDevice(SKETCH), new FakeDevice(SKETCH)];
    hid.event("connect", first);
    hid.event("connect", second);
    hid.event("connect", second);
    await settled();
    expect([first.opened, second.opened]).toEqual([false, true]);
    sent = [];
    second.report(1, 100, 0, 0, 0);
    port.tick();
    expect(samples().length).toBe(1);
  });

  it("A device that is selected before the port stops is not opened afterwards.", async () => {
    const late = new FakeDevice(SKETCH);
    hid.offers = [late];
    const request = port.selectDevice();
    await port.stop();
    await request;
    await settled();
    expect([port.name, late.opened]).toEqual([null, false]);
  });

  it("Stopping the port closes its device, and later connections are ignored.", async () => {
    hid.offers = [device];
    await port.selectDevice();
    await port.stop();
    expect([device.opened, disconnected.length]).toEqual([false, 1]);
    hid.event("connect", device);
    await settled();
    expect(port.name).toBeNull();
  });
});
