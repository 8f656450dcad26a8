import { describe, expect, it } from "vitest";
import { nextBrush, strokePoints, wantsBranch, wantsPath } from "./tools";

describe("tools", () => {
  it("show the way to the cursor where a click would use it", () => {
    expect(wantsPath("target")).toBe(true);
    expect(wantsPath("add")).toBe(false);
    expect([wantsBranch("fork", false), wantsBranch("fork", true)]).toEqual([true, false]);
    expect(wantsPath(null)).toBe(false);
  });

  it("have brushes from half a millimetre to a trachea, and stop at both ends", () => {
    expect(nextBrush(1.5, 1)).toBe(2);
    expect(nextBrush(1.5, -1)).toBe(1);
    expect(nextBrush(0.5, -1)).toBe(0.5);
    expect(nextBrush(12, 1)).toBe(12);
    expect(nextBrush(1.7, 1)).toBe(2);
  });

  it("send a stroke as few points, both ends among them", () => {
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
