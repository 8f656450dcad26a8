import { describe, expect, it } from "vitest";
import { type PlannedTurn, type RouteSpan, STRAIGHT_AHEAD } from "../wire/messages";
import { nextTurn } from "./route-dots";

const span = (branch_id: number, from_mm: number, to_mm: number, kind: RouteSpan["kind"] = "tracked"): RouteSpan => ({
  branch_id,
  name: null,
  generation: 0,
  from_mm,
  to_mm,
  kind,
});

const turn = (forkBranchId: number, into: number, ...dots: [number, number, number][]): PlannedTurn => ({
  head: "",
  facing: "",
  from_carina_mm: 0,
  from_fork_mm: 0,
  depth_estimate_mm: null,
  doubts: [],
  fork_branch_id: forkBranchId,
  seen_from_lps: [0, 0, 0],
  openings: [
    {
      branch_id: into,
      middle_lps: dots[0] ?? null,
      in_view: true,
      straight_ahead: false,
      ahead_deg: STRAIGHT_AHEAD.most_deg,
    },
  ],
  hour_doubt: null,
  dots_lps: dots,
});

describe("nextTurn", () => {
  const route = { spans: [span(0, 0, 50), span(1, 50, 70), span(2, 70, 90, "manual")] };
  const turns = [turn(0, 1, [1, 0, 0], [2, 0, 0]), turn(1, 2, [3, 0, 0])];

  it("is the turn at or ahead of the tip, with its dots", () => {
    const dots = [
      [1, 0, 0],
      [2, 0, 0],
    ];
    expect(nextTurn(route, turns, 20)).toEqual({ forkMm: 50, dots });
    expect(nextTurn(route, turns, 53)).toEqual({ forkMm: 50, dots });
    expect(nextTurn(route, turns, 75)).toBeNull();
  });

  it("A branch that the CT does not show has no dots.", () => {
    expect(nextTurn(route, turns, 60)).toEqual({ forkMm: 70, dots: [] });
  });

  it("is null for an opening out of view and for turns of another route", () => {
    expect(nextTurn(route, [turn(0, 1)], 20)).toBeNull();
    expect(nextTurn(route, [turn(7, 8, [1, 0, 0])], 20)).toBeNull();
  });
});
