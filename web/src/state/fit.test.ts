import { describe, expect, it } from "vitest";
import type { Scope } from "../wire/messages";
import { comesFarthest, firstTooNarrow, thatPass } from "./fit";

const ROUTE = { wall_mm: [9, 5, 2.2, 3, 1.6], cumulative_mm: [0, 100, 200, 210, 260] };

const scope = (name: string, tip_mm: number, fit_mm = tip_mm + 0.4): Scope => ({
  name,
  title: name,
  tip_mm,
  fit_mm,
  channel_mm: null,
  fov_deg: null,
  view_up_deg: 0,
});
const THICK = scope("thick", 6);
const THIN = scope("thin", 3.9);
const FINE = scope("fine", 2.8);
const FINEST = scope("finest", 2.2);

describe("fit of an instrument on a route", () => {
  it("firstTooNarrow returns the first place below the needed diameter, although the lumen widens again beyond it.", () => {
    expect(firstTooNarrow(ROUTE, 6)).toEqual({ pathMm: 200, diameterMm: 4.4 });
    expect(firstTooNarrow(ROUTE, 4.4)).toEqual({ pathMm: 260, diameterMm: 3.2 });
    expect(firstTooNarrow(ROUTE, 3.2)).toBeNull();
  });

  it("thatPass returns the instruments that reach the end, thickest first.", () => {
    expect(thatPass(ROUTE, [FINEST, THICK, FINE, THIN])).toEqual([FINE, FINEST]);
    expect(thatPass(ROUTE, [THICK, THIN])).toEqual([]);
  });

  it("The needed diameter is that of fit_mm and not the nominal tip diameter.", () => {
    // The lumen of this route is 3.2 mm wide at its narrowest place.
    const nominal = scope("nominal", 3.2);
    const thickTube = scope("thick tube", 2, 3.6);
    expect(thatPass(ROUTE, [nominal, thickTube])).toEqual([]);
    expect(comesFarthest(ROUTE, [THICK, nominal])).toEqual({ scope: nominal, pathMm: 260 });
  });

  it("comesFarthest returns the instrument that advances farthest if none reaches the end, and null for no instruments.", () => {
    expect(comesFarthest(ROUTE, [THICK, THIN])).toEqual({ scope: THIN, pathMm: 260 });
    expect(comesFarthest(ROUTE, [])).toBeNull();
  });
});
