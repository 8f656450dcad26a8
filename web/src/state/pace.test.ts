import { describe, expect, it } from "vitest";
import { NO_PACE, PaceMeter } from "./pace";

describe("PaceMeter", () => {
  it("Before the first pose it returns NO_PACE.", () => {
    expect(new PaceMeter().read(5)).toEqual(NO_PACE);
  });

  it("The latency is the time from the arrival of a pose to the drawing of its picture.", () => {
    const meter = new PaceMeter();
    for (let pose = 1; pose <= 20; pose += 1) {
      meter.poseArrived(pose, pose * 40);
      meter.pictureDrawn(pose, pose * 40 + 33);
    }
    expect(meter.read(900)).toEqual({ fps: 25, ageMs: 33, waitingMs: 0 });
  });

  it("Pauses and finer pictures of a resting tip do not lower the frame rate.", () => {
    const meter = new PaceMeter();
    for (const [pose, at] of [
      [1, 0],
      [2, 50],
      [3, 100],
      [3, 250],
      [4, 9000],
      [5, 9050],
    ] as const) {
      meter.poseArrived(pose, at);
      meter.pictureDrawn(pose, at);
    }
    expect(meter.read(9050).fps).toBe(20);
  });

  it("waitingMs is the time for which the latest pose has waited for its picture.", () => {
    const meter = new PaceMeter();
    meter.poseArrived(1, 0);
    meter.pictureDrawn(1, 20);
    meter.poseArrived(2, 100);
    meter.poseArrived(3, 130);
    expect(meter.read(1130).waitingMs).toBe(1000);
    meter.pictureDrawn(2, 1140);
    expect(meter.read(1150).waitingMs).toBe(1020);
    meter.pictureDrawn(3, 1160);
    expect(meter.read(1170).waitingMs).toBe(0);
  });

  it("After 100,000 poses without a picture the latency of the latest one is still measured.", () => {
    const meter = new PaceMeter();
    for (let pose = 0; pose < 100_000; pose += 1) meter.poseArrived(pose, pose);
    meter.pictureDrawn(99_999, 100_000);
    expect(meter.read(100_000).ageMs).toBe(1);
  });
});

describe("PaceMeter with a replacement picture", () => {
  it("A replacement picture ends the waiting time and restarts the measurement.", () => {
    const meter = new PaceMeter();
    for (let pose = 1; pose < 20; pose += 1) {
      meter.poseArrived(pose, pose * 20);
      meter.pictureDrawn(pose, pose * 20 + 5);
    }
    expect(meter.read(400).fps).toBe(50);
    meter.poseArrived(20, 400);
    meter.placeholderDrawn(20);
    expect(meter.read(900)).toEqual({ fps: null, ageMs: null, waitingMs: 0 });
  });
});
