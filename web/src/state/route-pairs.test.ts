import { describe, expect, it } from "vitest";
import type { PlansMessage, RoutePair, TargetPlan } from "../wire/messages";
import { bestPair, pairRows, pairsText, withAvailable } from "./route-pairs";

const pair = (scope: string, route: string, outcome: string, available = true): RoutePair => ({
  scope,
  title: scope.toUpperCase(),
  tool: "needle-21g",
  route,
  outcome,
  share: 0.9,
  words: outcome,
  would: null,
  available,
});

const plan = {
  routes: [
    { key: "1-10.0", branch_name: "RB1" },
    { key: "2-20.0", branch_name: "RB2" },
    { key: "3-30.0", branch_name: "RB3" },
  ],
} as unknown as TargetPlan;

const plans = (pairs: RoutePair[], standing = "had", available: string[] | null = null) =>
  ({ pairs, pairs_standing: standing, available }) as unknown as PlansMessage;

describe("pairs of route and instrument", () => {
  const pairs = [
    pair("b", "2-20.0", "reaches"),
    pair("a", "1-10.0", "does not reach"),
    pair("b", "1-10.0", "does not reach"),
    pair("a", "2-20.0", "does not reach"),
    pair("c", "1-10.0", "reaches", false),
  ];

  it("pairRows has a row for each instrument, and a cell for each judged route in the plan's order.", () => {
    const rows = pairRows(plan, pairs);
    expect(rows.map((row) => [row.scope, row.available, row.cells.map((cell) => cell?.outcome ?? null)])).toEqual([
      ["b", true, ["does not reach", "reaches"]],
      ["a", true, ["does not reach", "does not reach"]],
      ["c", false, ["reaches", null]],
    ]);
  });

  it("The best pair is one of an available instrument, whatever the planned scope.", () => {
    expect(bestPair(pairs)?.scope).toBe("b");
    expect(bestPair(pairs.slice(1))).toBeNull();
    expect(pairsText(plan, plans(pairs))).toBe("B reaches by route 2 (RB2).");
  });

  it("pairsText says that none reaches only if no route of any available instrument does and all are judged.", () => {
    const none = pairs.slice(1);
    expect(pairsText(plan, plans(none, "making"))).toBeNull();
    expect(pairsText(plan, plans(none))).toBe("Of 2 instruments none is known to reach by one of the best 2 routes.");
    expect(pairsText(plan, plans(none, "had", ["a", "b"]))).toContain("Of 2 available instruments none");
  });

  it("withAvailable keeps one instrument, and returns null if all are marked.", () => {
    const library = ["a", "b", "c"];
    expect(withAvailable(library, null, "b", false)).toEqual(["a", "c"]);
    expect(withAvailable(library, ["a", "c"], "b", true)).toBeNull();
    expect(withAvailable(library, ["a"], "a", false)).toEqual(["a"]);
    expect(withAvailable(library, ["c"], "a", true)).toEqual(["a", "c"]);
  });
});
