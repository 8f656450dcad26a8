import { describe, expect, it } from "vitest";
import type { PlannedTurn, RouteInfo, RouteOffer } from "../wire/messages";
import { besideRouteMm, ROUTE_ROWS, turnBefore, turnText } from "./plan";

const turn = (at: [number, number, number] | null): PlannedTurn => ({
  head: "3 o'clock",
  facing: "9 o'clock",
  from_carina_mm: null,
  from_fork_mm: 20,
  depth_estimate_mm: null,
  doubts: [],
  fork_branch_id: 0,
  seen_from_lps: at,
  openings: [],
  hour_doubt: null,
});

describe("list of turns", () => {
  it("turnText returns the text for the operator's position.", () => {
    expect(turnText(turn(null), "head")).toBe("3 o'clock");
    expect(turnText(turn(null), "facing")).toBe("9 o'clock");
  });

  it("turnBefore returns the turn at whose viewpoint the tip is, and null elsewhere.", () => {
    const turns = [turn(null), turn([1, 2, 3]), turn([5, 5, 5])];
    expect(turnBefore(turns, [1, 2, 3.1])).toBe(1);
    expect(turnBefore(turns, [1, 2, 4])).toBeNull();
    expect(turnBefore(turns, null)).toBeNull();
    expect(turnBefore([], [1, 2, 3])).toBeNull();
  });

  it("besideRouteMm returns the nearest position on the route, and null for a tip outside the route's airways.", () => {
    const route = {
      points_lps: [
        [0, 0, 0],
        [0, 0, 10],
        [0, 0, 20],
      ],
      cumulative_mm: [0, 10, 20],
      radius_mm: [5, 4, 3],
    } as unknown as RouteInfo;
    expect(besideRouteMm(route, [3, 0, 11])).toBe(10);
    expect(besideRouteMm(route, [5, 0, 20])).toBeNull();
  });
});

describe("table of routes", () => {
  it("ROUTE_ROWS state the outlook of a route in the second row.", () => {
    const row = ROUTE_ROWS[1];
    expect(row?.title).toBe("Outlook");
    expect(row?.of({ outlook: "may reach" } as unknown as RouteOffer)).toBe("may reach");
  });
});
