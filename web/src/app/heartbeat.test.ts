import { describe, expect, it } from "vitest";
import { AWAKE_MS, DOZE_MS, Heartbeat, wakeByHand } from "./heartbeat";

const REFRESH_MS = 1000 / 60;

function heart() {
  const environment = { now: 0, goesOn: false, call: null as (() => void) | null, dueMs: 0 };
  const beats: { atMs: number; elapsedS: number }[] = [];
  const ask = (ms: number, call: () => void) => {
    environment.call = call;
    environment.dueMs = environment.now + ms;
    return () => {
      if (environment.call === call) environment.call = null;
    };
  };
  const made = new Heartbeat((elapsedS) => beats.push({ atMs: environment.now, elapsedS }), {
    nowMs: () => environment.now,
    nextRefresh: (call) => ask(REFRESH_MS, call),
    after: ask,
    goesOn: () => environment.goesOn,
  });
  const run = (untilMs: number) => {
    while (environment.call !== null && environment.dueMs <= untilMs) {
      const call = environment.call;
      environment.call = null;
      environment.now = environment.dueMs;
      call();
    }
    environment.now = untilMs;
  };
  return { environment, beats, made, run };
}

describe("Heartbeat", () => {
  it("It runs at every display refresh for AWAKE_MS after the start, and every DOZE_MS at rest.", () => {
    const { beats, made, run } = heart();
    made.start();
    run(AWAKE_MS);
    expect(beats.length).toBeGreaterThan(85);
    const before = beats.length;
    run(AWAKE_MS + 10_000);
    expect(beats.length - before).toBeLessThanOrEqual(10_000 / DOZE_MS + 2);
    expect(beats.length - before).toBeGreaterThan(90);
  });

  it("It runs at every display refresh during activity, and the elapsed times add up to the total time.", () => {
    const { environment, beats, made, run } = heart();
    environment.goesOn = true;
    made.start();
    run(20_000);
    expect(beats.length).toBeGreaterThan(1150);
    const totalS = beats.reduce((sum, beat) => sum + beat.elapsedS, 0);
    expect(totalS).toBeCloseTo((beats.at(-1)?.atMs ?? 0) / 1000, 6);
  });

  it("A wake-up at rest restarts it at the next refresh, and the time at rest is not part of the elapsed time.", () => {
    const { environment, beats, made, run } = heart();
    made.start();
    run(10_090);
    const before = beats.length;
    made.wake();
    run(10_090 + 2 * REFRESH_MS + 1);
    const woken = beats.slice(before);
    expect(woken.length).toBe(2);
    expect(woken[0]?.elapsedS).toBeCloseTo(REFRESH_MS / 1000, 6);
    expect(environment.dueMs - environment.now).toBeLessThanOrEqual(REFRESH_MS);
  });

  it("It returns to every refresh by itself when a check at rest finds activity.", () => {
    const { environment, beats, made, run } = heart();
    made.start();
    run(10_000);
    environment.goesOn = true;
    const before = beats.length;
    run(11_000);
    expect(beats.length - before).toBeGreaterThan(50);
  });

  it("It stops on request, and a wake-up after the stop has no effect.", () => {
    const { beats, made, run } = heart();
    made.start();
    run(100);
    made.stop();
    made.wake();
    const before = beats.length;
    run(5000);
    expect(beats.length).toBe(before);
  });

  it("wakeByHand reports every input event until its listener is removed.", () => {
    const target = new EventTarget();
    let numWakes = 0;
    const stop = wakeByHand(target, () => {
      numWakes += 1;
    });
    for (const sign of ["keydown", "pointermove", "wheel"]) target.dispatchEvent(new Event(sign));
    stop();
    target.dispatchEvent(new Event("keydown"));
    expect(numWakes).toBe(3);
  });
});
