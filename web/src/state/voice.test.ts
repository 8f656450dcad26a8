import { describe, expect, it } from "vitest";
import type { RunningTask } from "../wire/messages";
import { localVoice, speechAfter } from "./voice";

const RUNNING: RunningTask = {
  task: "inspect-all",
  flight: 1,
  elapsed_s: 1,
  num_steps: 18,
  steps_done: [],
  next_step: "RB1",
  arrow_branches: [],
  message: null,
  is_warning: false,
  paused: false,
  learner: null,
};

describe("the voice", () => {
  it("is an English voice of this computer, because others send the text to a server", () => {
    const far = { localService: false, lang: "en-GB" };
    const near = { localService: true, lang: "en-US" };
    expect(localVoice([far, { localService: true, lang: "de-DE" }, near])).toBe(near);
    expect(localVoice([far])).toBeNull();
    expect(localVoice([])).toBeNull();
  });

  /** Return the texts that are spoken for successive states of an attempt. */
  function spoken(...states: RunningTask[]): (string | null)[] {
    let before: RunningTask | null = null;
    let step: string | null = null;
    return states.map((now) => {
      const speech = speechAfter(before, now, step);
      before = now;
      step = speech.step;
      return speech.text;
    });
  }

  const SEEN = { ...RUNNING, message: "visited: RB1", next_step: "RB2" };
  const FAULT = { ...RUNNING, message: "touching the wall at 3 o'clock", is_warning: true, next_step: "RB2" };

  it("speaks the next step and a new event once", () => {
    expect(spoken(RUNNING, RUNNING, SEEN, SEEN)).toEqual(["Next: RB1", null, "Visited: RB1 Next: RB2", null]);
  });

  it("speaks a fault alone, and a step that changed with the fault after the fault", () => {
    const after = { ...FAULT, message: null, is_warning: false };
    expect(spoken(RUNNING, FAULT, FAULT, after, after)).toEqual([
      "Next: RB1",
      "Touching the wall at 3 o'clock",
      null,
      "Next: RB2",
      null,
    ]);
    expect(spoken(FAULT, after)).toEqual(["Touching the wall at 3 o'clock", "Next: RB2"]);
  });

  it("speaks nothing during a pause, and a step that changed with the pause after the pause", () => {
    const paused = { ...RUNNING, next_step: "RB2", paused: true };
    expect(spoken(RUNNING, paused, paused, { ...paused, paused: false })).toEqual([
      "Next: RB1",
      null,
      null,
      "Next: RB2",
    ]);
  });

  it("repeats no step after a fault or a pause without a new step", () => {
    const fault = { ...FAULT, next_step: "RB1" };
    expect(spoken(RUNNING, fault, RUNNING)).toEqual(["Next: RB1", "Touching the wall at 3 o'clock", null]);
    expect(spoken(RUNNING, { ...RUNNING, paused: true }, RUNNING)).toEqual(["Next: RB1", null, null]);
  });

  it("begins again with the first step of another attempt", () => {
    expect(spoken(RUNNING, { ...RUNNING, flight: 2 })).toEqual(["Next: RB1", "Next: RB1"]);
  });
});
