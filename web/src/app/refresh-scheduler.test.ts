import { describe, expect, it } from "vitest";
import { ACTIVE_MS, IDLE_POLL_MS, RefreshScheduler, wakeOnInput } from "./refresh-scheduler";

const REFRESH_MS = 1000 / 60;

function schedulerRig() {
  const environment = { now: 0, needsEveryRefresh: false, call: null as (() => void) | null, dueMs: 0 };
  const calls: { atMs: number; elapsedS: number }[] = [];
  const ask = (ms: number, call: () => void) => {
    environment.call = call;
    environment.dueMs = environment.now + ms;
    return () => {
      if (environment.call === call) environment.call = null;
    };
  };
  const made = new RefreshScheduler((elapsedS) => calls.push({ atMs: environment.now, elapsedS }), {
    nowMs: () => environment.now,
    nextRefresh: (call) => ask(REFRESH_MS, call),
    after: ask,
    needsEveryRefresh: () => environment.needsEveryRefresh,
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
  return { environment, calls, made, run };
}

describe("RefreshScheduler", () => {
  it("runs at every display refresh for ACTIVE_MS after the start, and every IDLE_POLL_MS at rest", () => {
    const { calls, made, run } = schedulerRig();
    made.start();
    run(ACTIVE_MS);
    expect(calls.length).toBeGreaterThan(85);
    const before = calls.length;
    run(ACTIVE_MS + 10_000);
    expect(calls.length - before).toBeLessThanOrEqual(10_000 / IDLE_POLL_MS + 2);
    expect(calls.length - before).toBeGreaterThan(90);
  });

  it("runs at every display refresh during activity, and the elapsed times add up to the total time", () => {
    const { environment, calls, made, run } = schedulerRig();
    environment.needsEveryRefresh = true;
    made.start();
    run(20_000);
    expect(calls.length).toBeGreaterThan(1150);
    const totalS = calls.reduce((sum, beat) => sum + beat.elapsedS, 0);
    expect(totalS).toBeCloseTo((calls.at(-1)?.atMs ?? 0) / 1000, 6);
  });

  it("A wake-up at rest restarts it at the next refresh, and the time at rest is not part of the elapsed time.", () => {
    const { environment, calls, made, run } = schedulerRig();
    made.start();
    run(10_090);
    const before = calls.length;
    made.wake();
    run(10_090 + 2 * REFRESH_MS + 1);
    const woken = calls.slice(before);
    expect(woken.length).toBe(2);
    expect(woken[0]?.elapsedS).toBeCloseTo(REFRESH_MS / 1000, 6);
    expect(environment.dueMs - environment.now).toBeLessThanOrEqual(REFRESH_MS);
  });

  it("returns to every refresh by itself when a check at rest finds activity", () => {
    const { environment, calls, made, run } = schedulerRig();
    made.start();
    run(10_000);
    environment.needsEveryRefresh = true;
    const before = calls.length;
    run(11_000);
    expect(calls.length - before).toBeGreaterThan(50);
  });

  it("stops on request, and a wake-up after the stop has no effect", () => {
    const { calls, made, run } = schedulerRig();
    made.start();
    run(100);
    made.stop();
    made.wake();
    const before = calls.length;
    run(5000);
    expect(calls.length).toBe(before);
  });

  it("wakeOnInput reports every input event until its listener is removed.", () => {
    const target = new EventTarget();
    let numWakes = 0;
    const stop = wakeOnInput(target, () => {
      numWakes += 1;
    });
    for (const sign of ["keydown", "pointermove", "wheel"]) target.dispatchEvent(new Event(sign));
    stop();
    target.dispatchEvent(new Event("keydown"));
    expect(numWakes).toBe(3);
  });
});
