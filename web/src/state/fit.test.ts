import { describe, expect, it } from "vitest";
import type { Scope } from "../wire/messages";
import { fitOf, reachText, thatFit } from "./fit";

const ROUTE = {
  scope_fits: [
    { scope: "thick", fit: "does not fit" },
    { scope: "thin", fit: "may fit" },
    { scope: "fine", fit: "fits" },
    { scope: "finest", fit: "fits" },
  ],
} as const;

const scope = (name: string, tip_mm: number): Scope => ({
  name,
  title: name,
  tip_mm,
  fit_mm: tip_mm + 0.4,
  channel_mm: null,
  fov_deg: null,
  view_up_deg: 0,
});
const THICK = scope("thick", 6);
const THIN = scope("thin", 3.9);
const FINE = scope("fine", 2.8);
const FINEST = scope("finest", 2.2);

describe("fit of an instrument on a route", () => {
  it("fitOf returns the stated fit, and null for an unmeasured route or an unknown instrument.", () => {
    expect(fitOf(ROUTE, "thin")).toBe("may fit");
    expect(fitOf(ROUTE, "other")).toBeNull();
    expect(fitOf({ scope_fits: [] }, "thin")).toBeNull();
  });

  it("thatFit returns the instruments that certainly pass, thickest first.", () => {
    expect(thatFit(ROUTE, [FINEST, THICK, FINE, THIN])).toEqual([FINE, FINEST]);
    expect(thatFit(ROUTE, [THICK, THIN])).toEqual([]);
  });

  it("reachText states the end only for an instrument that certainly passes.", () => {
    expect(reachText("fits", "90 mm", "60 mm")).toBe("the end, 90 mm");
    expect(reachText("may fit", "90 mm", "60 mm")).toBe("maybe the end, 90 mm");
    expect(reachText("does not fit", "90 mm", "60 mm")).toBe("no farther than 60 mm");
  });
});
