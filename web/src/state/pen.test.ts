import { describe, expect, it } from "vitest";
import type { PenMessage, StateMessage } from "../wire/messages";
import { INITIAL_STATE, penPoint, reduce } from "./app-state";
import { penMarkText, penOffText, wasUsedByPen } from "./pen";

const pen = (change: Partial<PenMessage> = {}): PenMessage => ({
  type: "pen",
  device: "pen",
  tracked: true,
  lps: [1, 2, 3],
  off_mm: null,
  off_deg: null,
  ...change,
});

describe("point that the pen's button marks", () => {
  it("The text names the pen's tip if the pen is registered, else the scope's tip and the reason.", () => {
    expect(penMarkText(pen())).toContain("the pen tip");
    expect(penMarkText(pen({ lps: null }))).toBe(
      "The pen is not registered: its button marks the position of the scope tip.",
    );
    expect(penMarkText(pen({ lps: null, tracked: false }))).toContain("is not tracked");
  });

  it("penPoint returns the pen's point, and null if no pen moves the tip.", () => {
    const reported = reduce(INITIAL_STATE, { kind: "server", message: pen() });
    expect(penPoint(reported)).toEqual([1, 2, 3]);
    const disconnected = reduce(reported, { kind: "server", message: pen({ device: null, lps: null }) });
    expect(disconnected.pen).toBeNull();
    expect(penPoint(disconnected)).toBeNull();
  });
});

describe("wasUsedByPen", () => {
  const reported = (num: number, airways: StateMessage["airways"]) =>
    ({ targets: Array.from({ length: num }), airways }) as unknown as StateMessage;

  it("is true only for a pen tool whose target was added or whose search has started", () => {
    expect(wasUsedByPen("target", reported(0, "found"), reported(1, "found"))).toBe(true);
    expect(wasUsedByPen("target", reported(1, "found"), reported(1, "found"))).toBe(false);
    expect(wasUsedByPen("add", reported(0, "found"), reported(1, "found"))).toBe(false);
    expect(wasUsedByPen("root", reported(0, "found"), reported(0, "finding"))).toBe(true);
    expect(wasUsedByPen("root", reported(0, "finding"), reported(0, "finding"))).toBe(false);
    expect(wasUsedByPen("target", null, reported(1, "found"))).toBe(false);
  });
});

describe("penOffText", () => {
  it("The text states the offset between pen and tip, and is null below the displayed precision.", () => {
    expect(penOffText(null)).toBeNull();
    expect(penOffText(pen())).toBeNull();
    expect(penOffText(pen({ off_mm: 56.21, off_deg: 12 }))).toMatch(/^56\.2.mm, 12\u00b0$/);
    expect(penOffText(pen({ off_mm: 0.2, off_deg: 0 }))).toMatch(/^0\.2.mm$/);
    expect(penOffText(pen({ off_mm: 0, off_deg: 3 }))).toMatch(/^0\.0.mm, 3\u00b0$/);
    expect(penOffText(pen({ off_mm: 0.04, off_deg: 0.4 }))).toBeNull();
  });
});
