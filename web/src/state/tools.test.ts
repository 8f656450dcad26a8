import { describe, expect, it } from "vitest";
import { nextBrush, strokePoints, wantsBranch, wantsPath } from "./tools";

describe("tools", () => {
  it("The path to the cursor is shown only for tools whose click uses it, and the fork tool first selects a branch.", () => {
    expect(wantsPath("target")).toBe(true);
    expect(wantsPath("add")).toBe(false);
    expect([wantsBranch("fork", false), wantsBranch("fork", true)]).toEqual([true, false]);
    expect(wantsPath(null)).toBe(false);
  });

  it("nextBrush returns the next brush radius and stops at both ends of the list.", () => {
    expect(nextBrush(1.5, 1)).toBe(2);
    expect(nextBrush(1.5, -1)).toBe(1);
    expect(nextBrush(0.5, -1)).toBe(0.5);
    expect(nextBrush(12, 1)).toBe(12);
    expect(nextBrush(1.7, 1)).toBe(2);
  });

  it("strokePoints reduces a stroke to few points that include both ends.", () => {
    const drawn = Array.from({ length: 101 }, (_, n) => [n / 10, 0, 0] as const);
    const sent = strokePoints(drawn, 2);
    expect(sent[0]).toEqual([0, 0, 0]);
    expect(sent.at(-1)).toEqual([10, 0, 0]);
    expect(sent.length).toBeLessThan(23);
    for (let n = 1; n < sent.length; n += 1) expect((sent[n]?.[0] ?? 0) - (sent[n - 1]?.[0] ?? 0)).toBeLessThan(0.61);
    expect(strokePoints([[1, 2, 3] as const], 2)).toEqual([[1, 2, 3]]);
    expect(strokePoints([], 2)).toEqual([]);
  });
});
