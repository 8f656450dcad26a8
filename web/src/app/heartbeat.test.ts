import { describe, expect, it } from "vitest";
import { AWAKE_MS, DOZE_MS, Heartbeat, wakeByHand } from "./heartbeat";

const REFRESH_MS = 1000 / 60;

function heart() {
  const around = { now: 0, goesOn: false, call: null as (() => void) | null, dueMs: 0 };
  const beats: { atMs: number; elapsedS: number }[] = [];
  const ask = (ms: number, call: () => void) => {
    around.call = call;
    around.dueMs = around.now + ms;
    return () => {
      if (around.call === call) around.call = null;
    };
  };
  const made = new Heartbeat((elapsedS) => beats.push({ atMs: around.now, elapsedS }), {
    nowMs: () => around.now,
    nextRefresh: (call) => ask(REFRESH_MS, call),
    after: ask,
    goesOn: () => around.goesOn,
  });
  const run = (untilMs: number) => {
    while (around.call !== null && around.dueMs <= untilMs) {
      const call = around.call;
      around.call = null;
      around.now = around.dueMs;
      call();
    }
    around.now = untilMs;
  };
  return { around, beats, made, run };
}

describe("heartbeat", () => {
  it("beats with every refresh for a while and dozes when nothing happens", () => {
    const { beats, made, run } = heart();
    made.start();
    run(AWAKE_MS);
    expect(beats.length).toBeGreaterThan(85);
    const before = beats.length;
    run(AWAKE_MS + 10_000);
    expect(beats.length - before).toBeLessThanOrEqual(10_000 / DOZE_MS + 2);
    expect(beats.length - before).toBeGreaterThan(90);
  });

  it("keeps awake while something goes on, and counts all time that passes", () => {
    const { around, beats, made, run } = heart();
    around.goesOn = true;
    made.start();
    run(20_000);
    expect(beats.length).toBeGreaterThan(1150);
    const told = beats.reduce((sum, beat) => sum + beat.elapsedS, 0);
    expect(told).toBeCloseTo((beats.at(-1)?.atMs ?? 0) / 1000, 6);
  });

  it("wakes at once, and what nobody looked at is not counted as held", () => {
    const { around, beats, made, run } = heart();
    made.start();
    run(10_090);
    const before = beats.length;
    made.wake();
    run(10_090 + 2 * REFRESH_MS + 1);
    const woken = beats.slice(before);
    expect(woken.length).toBe(2);
    expect(woken[0]?.elapsedS).toBeCloseTo(REFRESH_MS / 1000, 6);
    expect(around.dueMs - around.now).toBeLessThanOrEqual(REFRESH_MS);
  });

  it("wakes by itself where a look finds that something has begun", () => {
    const { around, beats, made, run } = heart();
    made.start();
    run(10_000);
    around.goesOn = true;
    const before = beats.length;
    run(11_000);
    expect(beats.length - before).toBeGreaterThan(50);
  });

  it("stops, also from within, and a sign of a hand does not start it again", () => {
    const { beats, made, run } = heart();
    made.start();
    run(100);
    made.stop();
    made.wake();
    const before = beats.length;
    run(5000);
    expect(beats.length).toBe(before);
  });

  it("hears every sign of a hand until told not to", () => {
    const target = new EventTarget();
    let heard = 0;
    const stop = wakeByHand(target, () => {
      heard += 1;
    });
    for (const sign of ["keydown", "pointermove", "wheel"]) target.dispatchEvent(new Event(sign));
    stop();
    target.dispatchEvent(new Event("keydown"));
    expect(heard).toBe(3);
  });
});
