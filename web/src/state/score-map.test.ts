import { describe, expect, it } from "vitest";
import { spread } from "./score-map";

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
