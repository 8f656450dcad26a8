import { describe, expect, it } from "vitest";
import { SpeedMeter, shownSpeed } from "./speed";

/** Feed `num` poses at a constant speed, one every `gapMs`; return the time of the last pose. */
function fly(meter: SpeedMeter, mmS: number, num: number, gapMs: number, from = { atMs: 1000, z: 0 }) {
  let { atMs, z } = from;
  for (let n = 0; n < num; n += 1) {
    atMs += gapMs;
    z += (mmS * gapMs) / 1000;
    meter.poseArrived([0, 0, z], atMs);
  }
  return { atMs, z };
}

describe("the speed of the tip", () => {
  it("is the way by the time, at any rate of poses", () => {
    for (const gapMs of [8, 16, 33, 90]) {
      const meter = new SpeedMeter();
      const { atMs } = fly(meter, 20, 60, gapMs);
      expect(meter.read(atMs)).toBeCloseTo(20, 6);
    }
  });

  it("is steady where poses come in bunches", () => {
    const meter = new SpeedMeter();
    let atMs = 0;
    for (let n = 0; n < 120; n += 1) {
      atMs += n % 3 === 0 ? 40 : 5;
      meter.poseArrived([0, 0, (n * 50) / 3 / 50], atMs);
    }
    // Three steps of a third of a millimetre in 50 ms: 20 mm/s.
    const speed = meter.read(atMs) ?? 0;
    expect(Math.abs(speed - 20)).toBeLessThan(1.5);
  });

  it("follows a change within its window", () => {
    const meter = new SpeedMeter();
    const now = fly(meter, 20, 60, 16);
    const { atMs } = fly(meter, 5, 45, 16, now);
    expect(meter.read(atMs)).toBeCloseTo(5, 6);
  });

  it("is none at rest, and none for a tip that turns on the spot", () => {
    const meter = new SpeedMeter();
    expect(meter.read(0)).toBeNull();
    const { atMs, z } = fly(meter, 20, 60, 16);
    expect(meter.read(atMs + 400)).toBeNull();
    for (let n = 0; n < 40; n += 1) meter.poseArrived([0, 0, z], atMs + 16 * n);
    expect(meter.read(atMs + 16 * 40)).toBeNull();
  });

  it("is not shaken by a tip that is put elsewhere, nor by the step that begins a movement", () => {
    const meter = new SpeedMeter();
    let now = fly(meter, 20, 60, 16);
    now = { atMs: now.atMs + 16, z: now.z + 120 };
    meter.poseArrived([0, 0, now.z], now.atMs);
    expect(meter.read(now.atMs)).toBeNull();
    now = { atMs: now.atMs + 5000, z: now.z + 3 };
    meter.poseArrived([0, 0, now.z], now.atMs);
    expect(meter.read(now.atMs)).toBeNull();
    now = fly(meter, 20, 30, 16, now);
    expect(meter.read(now.atMs)).toBeCloseTo(20, 6);
  });

  it("is shown in whole numbers, in tenths where it is slow", () => {
    expect([null, 0.04, 4.96, 9.94, 9.96, 20.4].map(shownSpeed)).toEqual([null, 0, 5, 9.9, 10, 20]);
  });
});
