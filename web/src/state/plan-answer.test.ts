import { describe, expect, it } from "vitest";
import type { NeedleLeg, RouteOffer, ScopeVerdict, TargetPlan } from "../wire/messages";
import { INITIAL_STATE } from "./app-state";
import { answeredPlan, answerOf, needleText, vesselText } from "./plan-answer";

const LEG: NeedleLeg = {
  tip_lps: [0, 0, 0],
  aim_lps: [0, 0, 10],
  to_target_mm: 7.4,
  angle_deg: 12,
  crossed: [{ tissue: "lung", from_mm: 0, to_mm: 7.4 }],
  in_target_mm: 9,
  vessel_mm: 5,
  hit_share: 1,
  hit_share_moved: 0.17,
};

const planned = (chosen: number | null, outlooks: readonly string[], problem: string | null = null): TargetPlan =>
  ({
    target_id: "target-1",
    chosen,
    problem,
    unconfirmed: [],
    options: { scope: "thin" },
    routes: outlooks.map((outlook) => ({ outlook }) as unknown as RouteOffer),
  }) as unknown as TargetPlan;

describe("answer of a plan", () => {
  it("answerOf states the outlook of the best route until a route is chosen.", () => {
    expect(answerOf(planned(null, ["may reach", "does not reach"]), [], "unwanted")).toEqual({
      kind: "may-reach",
      headline: "may reach",
      words: "by the best of 2 routes",
    });
  });

  it("answerOf states the verdict of the planned instrument once it is known.", () => {
    const verdict = { scope: "thin", outcome: "reaches", words: "reaches." } as unknown as ScopeVerdict;
    const other = { scope: "ebus", outcome: "does not reach", words: "too wide" } as unknown as ScopeVerdict;
    const plan = planned(2, ["does not reach", "may reach"]);
    expect(answerOf(plan, [other], "making")).toEqual({
      kind: "may-reach",
      headline: "may reach",
      words: "the drive is being simulated",
    });
    expect(answerOf(plan, [other, verdict], "had")).toEqual({ kind: "reaches", headline: "reaches", words: "reaches" });
  });

  it("answerOf states the problem of a plan without routes.", () => {
    expect(answerOf(planned(null, [], "no airway is near enough."), [], "unwanted")).toEqual({
      kind: "does-not-reach",
      headline: "no route",
      words: "no airway is near enough",
    });
  });

  it("answerOf and answeredPlan keep the answer while the routes are planned again.", () => {
    const plan = planned(null, []);
    expect(answerOf(plan, [], "unwanted").headline).toBe("planning the routes\u2026");
    const at = (standing: "making" | "had") => ({
      ...INITIAL_STATE,
      plans: { targets: [plan], standing } as unknown as NonNullable<typeof INITIAL_STATE.plans>,
      ui: { ...INITIAL_STATE.ui, step: "target" as const },
    });
    expect(answeredPlan(at("making"))).toBe(plan);
    expect(answeredPlan(at("had"))).toBeNull();
  });

  it("answeredPlan is null in other steps and while the user must confirm doubts.", () => {
    const plan = planned(null, ["reaches"]);
    const plans = { targets: [plan] } as unknown as NonNullable<typeof INITIAL_STATE.plans>;
    const at = (step: "target" | "rehearse") => ({ ...INITIAL_STATE, plans, ui: { ...INITIAL_STATE.ui, step } });
    expect(answeredPlan(at("target"))).toBe(plan);
    expect(answeredPlan(at("rehearse"))).toBeNull();
    expect(answeredPlan({ ...at("target"), watches: true })).toBeNull();
    const unconfirmed = { targets: [{ ...plan, unconfirmed: ["target.tube"] }] } as unknown as typeof plans;
    expect(answeredPlan({ ...at("target"), plans: unconfirmed })).toBeNull();
  });

  it("needleText and vesselText state the needle's path, and warn of vessels within the margin.", () => {
    expect(needleText(LEG)).toBe(
      "7\u202fmm to the target, 12\u00b0 to the airway, hits 100\u202f% (17\u202f% if moved)",
    );
    expect(vesselText(LEG, 3)).toEqual({ text: "5.0\u202fmm from the needle", warns: false });
    expect(vesselText({ ...LEG, vessel_mm: 2 }, 3).warns).toBe(true);
    expect(vesselText({ ...LEG, vessel_mm: null }, 3)).toEqual({ text: "none seen near the needle", warns: false });
    const crossed = [{ tissue: "vessel", from_mm: 1, to_mm: 3 }];
    expect(vesselText({ ...LEG, vessel_mm: 0, crossed }, 3)).toEqual({
      text: "on the needle\u2019s way, 2\u202fmm through it",
      warns: true,
    });
  });
});
