import { describe, expect, it } from "vitest";
import type { ClientMessage } from "../../wire/messages";
import { fieldsOf, type HidCollection, readField, scaled } from "./hid";
import type { HidDevice } from "./hid-port";
import { SpaceMouse } from "./spacemouse";

const axes = (first: number): HidCollection["inputReports"] => [
  {
    reportId: first === 0x10030 ? 1 : 2,
    items: [
      {
        usages: [first, first + 1, first + 2],
        reportSize: 16,
        reportCount: 3,
        logicalMinimum: -350,
        logicalMaximum: 350,
      },
    ],
  },
];
/** The descriptor of a SpaceMouse Compact: two reports of three axes, one report of buttons. */
const COMPACT: readonly HidCollection[] = [
  {
    inputReports: [
      ...(axes(0x10030) ?? []),
      ...(axes(0x10033) ?? []),
      {
        reportId: 3,
        items: [
          {
            isRange: true,
            usageMinimum: 0x90001,
            usageMaximum: 0x90002,
            reportSize: 1,
            reportCount: 2,
            logicalMinimum: 0,
            logicalMaximum: 1,
          },
          { usages: [], reportSize: 1, reportCount: 14 },
        ],
      },
    ],
    children: [{ inputReports: axes(0x10030) }],
  },
];

class FakeDevice extends EventTarget implements HidDevice {
  readonly vendorId = 0x256f;
  readonly productId = 0xc635;
  readonly productName = "SpaceMouse Compact";
  opened = false;
  readonly collections = COMPACT;
  open(): Promise<void> {
    this.opened = true;
    return Promise.resolve();
  }
  close(): Promise<void> {
    this.opened = false;
    return Promise.resolve();
  }
  report(reportId: number, ...numbers: number[]): void {
    const data = new DataView(new ArrayBuffer(2 * numbers.length));
    for (const [n, value] of numbers.entries()) data.setInt16(2 * n, value, true);
    this.dispatchEvent(Object.assign(new Event("inputreport"), { reportId, data }));
  }
}

describe("fieldsOf and readField", () => {
  it("Axes and buttons are located by usage and bit offset in their reports.", () => {
    const fields = fieldsOf(COMPACT);
    expect(fields.get(1)?.map((f) => [f.usage, f.bit])).toEqual([
      [0x10030, 0],
      [0x10031, 16],
      [0x10032, 32],
    ]);
    expect(fields.get(3)?.map((f) => f.usage)).toEqual([0x90001, 0x90002]);
  });

  it("readField returns values of any size at any bit with their sign, and null beyond the report's end.", () => {
    const data = new DataView(Uint8Array.from([0b1011_0000, 0b0000_0001, 0xff]).buffer);
    const field = { usage: 0, bit: 4, size: 5, minimum: 0, maximum: 31 };
    expect(readField(data, field)).toBe(0b11011);
    expect(readField(data, { ...field, minimum: -16 })).toBe(0b11011 - 32);
    expect(readField(data, { ...field, bit: 22 })).toBeNull();
    expect(scaled(15, { ...field, minimum: -15, maximum: 15 })).toBe(1);
    expect(scaled(900, { ...field, minimum: -15, maximum: 15 })).toBe(1);
    expect(scaled(3, { ...field, minimum: 0, maximum: 0 })).toBe(0);
  });
});

describe("SpaceMouse", () => {
  it("The cap moves the tip, its rest position is sent once, and nothing is sent after the device was closed.", async () => {
    const device = new FakeDevice();
    const sent: ClientMessage[] = [];
    let now = 0;
    const mouse = new SpaceMouse(
      device,
      (message) => sent.push(message),
      () => {
        now += 0.016;
        return now;
      },
    );
    await mouse.open();
    expect(mouse.problem).toBeNull();
    mouse.tick();
    expect(sent).toEqual([]);
    for (let flood = 0; flood < 500; flood += 1) device.report(1, 0, -350, 0);
    device.report(2, 0, 0, 350);
    mouse.tick();
    expect(sent).toHaveLength(1);
    expect(sent[0]).toMatchObject({ type: "device_sample", axes: [1, 0, 0, 1, 0, 0], buttons: 0 });
    device.report(1, 0, 0, 0);
    device.report(2, 0, 0, 0);
    device.report(3, 0b10);
    mouse.tick();
    expect(sent[1]).toMatchObject({ axes: [0, 0, 0, 0, 0, 0], buttons: 2 });
    // Reports of the cap do not contain the buttons.
    device.report(1, 0, 0, 0);
    mouse.tick();
    expect(sent[2]).toMatchObject({ buttons: 2 });
    device.report(3, 0);
    mouse.tick();
    mouse.tick();
    expect(sent).toHaveLength(4);
    device.report(9, 1, 2, 3);
    device.report(1, 5);
    await mouse.close();
    expect([device.opened, sent.length]).toEqual([false, 4]);
  });
});
