import { describe, expect, it } from "vitest";
import type { FlightScore } from "../wire/messages";
import { replayMarks, spread } from "./score-map";

describe("spread", () => {
  it("moves positions apart that would cover each other, and changes no others", () => {
    expect(spread([0.2, 0.8], 0.1)).toEqual([0.2, 0.8]);
    const [later, first] = spread([0.51, 0.5], 0.1);
    expect(first).toBeCloseTo(0.5);
    expect(later).toBeCloseTo(0.6);
  });

  it("keeps positions at the end of the line on the line", () => {
    const found = spread([0.99, 1, 0.98], 0.1);
    expect(found.map((value) => Number(value.toFixed(6)))).toEqual([0.9, 1, 0.8]);
  });
});

describe("replayMarks", () => {
  it("numbers the faults, and gives letters to the high-error events", () => {
    const moment = (time_s: number) => ({ time_s, words: `moment ${time_s}` });
    const score = { moments: [moment(2), moment(5)], comparison_moments: [moment(3)] } as unknown as FlightScore;
    expect(replayMarks(score).map(({ label, time_s, isHighError }) => [label, time_s, isHighError])).toEqual([
      ["1", 2, false],
      ["2", 5, false],
      ["A", 3, true],
    ]);
  });
});
