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

describe("SpeedMeter", () => {
  it("The speed is distance by time for any rate of poses.", () => {
    for (const gapMs of [8, 16, 33, 90]) {
      const meter = new SpeedMeter();
      const { atMs } = fly(meter, 20, 60, gapMs);
      expect(meter.read(atMs)).toBeCloseTo(20, 6);
    }
  });

  it("The speed is within 1.5 mm/s of the true one for poses that arrive in bursts.", () => {
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

  it("After a change the new speed is reached within the averaging window.", () => {
    const meter = new SpeedMeter();
    const now = fly(meter, 20, 60, 16);
    const { atMs } = fly(meter, 5, 45, 16, now);
    expect(meter.read(atMs)).toBeCloseTo(5, 6);
  });

  it("The speed is null at rest and for a tip that only turns.", () => {
    const meter = new SpeedMeter();
    expect(meter.read(0)).toBeNull();
    const { atMs, z } = fly(meter, 20, 60, 16);
    expect(meter.read(atMs + 400)).toBeNull();
    for (let n = 0; n < 40; n += 1) meter.poseArrived([0, 0, z], atMs + 16 * n);
    expect(meter.read(atMs + 16 * 40)).toBeNull();
  });

  it("The speed is null after a jump of the tip and at the first step of a movement.", () => {
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

  it("shownSpeed returns whole numbers, and tenths below 10 mm/s.", () => {
    expect([null, 0.04, 4.96, 9.94, 9.96, 20.4].map(shownSpeed)).toEqual([null, 0, 5, 9.9, 10, 20]);
  });
});
