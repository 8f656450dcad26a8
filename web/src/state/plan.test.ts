import { describe, expect, it } from "vitest";
import {
  FIRST_SIGHT,
  type PlannedTurn,
  type RouteInfo,
  type RouteOffer,
  type ScopeVerdict,
  type StationOnRoute,
  type TargetPlan,
} from "../wire/messages";
import {
  distanceToRouteMm,
  isCArmAt,
  othersText,
  ROUTE_ROWS,
  stationsShown,
  stationText,
  turnBefore,
  turnText,
} from "./plan";

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
  dots_lps: [],
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

  it("distanceToRouteMm returns the nearest position on the route, and null for a tip outside the route's airways.", () => {
    const route = {
      points_lps: [
        [0, 0, 0],
        [0, 0, 10],
        [0, 0, 20],
      ],
      cumulative_mm: [0, 10, 20],
      radius_mm: [5, 4, 3],
    } as unknown as RouteInfo;
    expect(distanceToRouteMm(route, [3, 0, 11])).toBe(10);
    expect(distanceToRouteMm(route, [5, 0, 20])).toBeNull();
  });
});

describe("stations of a route", () => {
  const station: StationOnRoute = {
    station: "7",
    head: "9 o'clock",
    facing: "3 o'clock",
    point_lps: [1, 2, 3],
    direction_lps: [1, 0, 0],
    borders: "",
    doubts: [],
  };
  const same = { ...station, station: "10R" };
  const above = { ...station, station: "4R", point_lps: [1, 2, 30] };
  const plan = { stations: [above, station, same] } as unknown as TargetPlan;

  it("stationText returns the text for the operator's position.", () => {
    expect(stationText(station, "head")).toBe("9 o'clock");
    expect(stationText(station, "facing")).toBe("3 o'clock");
  });

  it("stationsShown returns the stations at the crosshair, and none while the slices follow the tip.", () => {
    expect(stationsShown(plan, [1, 2, 3])).toEqual([station, same]);
    expect(stationsShown(plan, [1, 2, 3.5])).toEqual([]);
    expect(stationsShown(plan, null)).toEqual([]);
    expect(stationsShown(null, [1, 2, 3])).toEqual([]);
  });
});

describe("C-arm angles", () => {
  it("isCArmAt compares both angles with their signs.", () => {
    const position = { primary_deg: 30, secondary_deg: -10, name: "", words: "" };
    const carm = { ...FIRST_SIGHT.carm, primary_deg: 30.2, secondary_deg: -10 };
    expect(isCArmAt(carm, position)).toBe(true);
    expect(isCArmAt({ ...carm, secondary_deg: 10 }, position)).toBe(false);
    expect(isCArmAt({ ...carm, primary_deg: -30 }, position)).toBe(false);
  });
});

describe("table of routes", () => {
  it("ROUTE_ROWS state the outlook of a route in the second row.", () => {
    const row = ROUTE_ROWS[1];
    expect(row?.title).toBe("Outlook");
    expect(row?.of({ outlook: "may reach" } as unknown as RouteOffer)).toBe("may reach");
  });
});

describe("other instruments", () => {
  const verdicts = (...outcomes: string[]) => outcomes.map((outcome) => ({ outcome })) as unknown as ScopeVerdict[];

  it("The text counts those that reach the target apart from those that may reach it.", () => {
    const others = verdicts("may reach", "reaches", "cannot say", "may reach", "does not reach");
    expect(othersText(others, "had")).toBe("5 other instruments: 1 reach it, 2 may reach it");
    expect(othersText(verdicts("cannot say"), "had")).toBe("1 other instruments: 0 reach it, 0 may reach it");
  });

  it("The text ends with 'so far' while the verdicts on the other instruments are being computed.", () => {
    expect(othersText(verdicts("reaches"), "making")).toBe("1 other instruments: 1 reach it, 0 may reach it so far");
  });
});
