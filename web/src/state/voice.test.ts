import { describe, expect, it } from "vitest";
import type { RunningTask } from "../wire/messages";
import { localVoice, spokenText } from "./voice";

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

  it("speaks the next step and a new event once", () => {
    expect(spokenText(null, RUNNING)).toBe("Next: RB1");
    expect(spokenText(RUNNING, RUNNING)).toBeNull();
    const seen = { ...RUNNING, message: "visited: RB1", next_step: "RB2" };
    expect(spokenText(RUNNING, seen)).toBe("Visited: RB1 Next: RB2");
    expect(spokenText(seen, seen)).toBeNull();
  });

  it("speaks a fault alone, and nothing during a pause", () => {
    const fault = { ...RUNNING, message: "touching the wall at 3 o'clock", is_warning: true, next_step: "RB2" };
    expect(spokenText(RUNNING, fault)).toBe("Touching the wall at 3 o'clock");
    expect(spokenText(RUNNING, { ...fault, paused: true })).toBeNull();
  });
});
