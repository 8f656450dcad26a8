/** Texts of the answer of a plan: the plan that is shown, whether its target is reached, the needle, and the vessel. */

import type { NeedleLeg, ScopeVerdict, TargetPlan } from "../wire/messages";
import type { AppState } from "./app-state";
import { fixed, mm } from "./format";
import { planOf, share } from "./plan";

/** Steps whose window shows the answer of a plan; in the other steps the pictures need the space. */
const ANSWER_STEPS: ReadonlySet<AppState["ui"]["step"]> = new Set(["target", "route", "share"]);

/**
 * Return the plan whose answer is shown: that of the route's target, else that of the target added last. Null in other
 * steps, in a window that only watches, and while the user must confirm doubts about the target.
 */
export function answeredPlan(state: AppState): TargetPlan | null {
  if (state.watches || !ANSWER_STEPS.has(state.ui.step)) return null;
  const plan = planOf(state.plans, state.route?.target_id ?? null) ?? state.plans?.targets.at(-1) ?? null;
  if (plan === null || plan.unconfirmed.length > 0) return null;
  // While the routes are planned again, the answer stays, so that the pictures keep their size.
  const isPlanned = plan.routes.length > 0 || plan.problem !== null;
  return isPlanned || state.plans?.standing === "making" ? plan : null;
}

/** Text that states whether a target is reached. */
export interface ReachAnswer {
  readonly kind: "reaches" | "may-reach" | "does-not-reach" | "cannot-say";
  readonly headline: string;
  /** Explanation without a full stop; null if there is none. */
  readonly words: string | null;
}

const KINDS: Readonly<Record<string, ReachAnswer["kind"]>> = {
  reaches: "reaches",
  "may reach": "may-reach",
  "does not reach": "does-not-reach",
};

/** Return whether the planned instrument reaches the target by the chosen route, else by the best route. */
export function answerOf(plan: TargetPlan, verdicts: readonly ScopeVerdict[], standing: string): ReachAnswer {
  const route = plan.routes[(plan.chosen ?? 1) - 1] ?? null;
  if (route === null) {
    if (plan.problem === null) return { kind: "cannot-say", headline: "planning the routes\u2026", words: null };
    return { kind: "does-not-reach", headline: "no route", words: withoutStop(plan.problem) };
  }
  const own = plan.chosen === null ? null : (verdicts.find((one) => one.scope === plan.options.scope) ?? null);
  if (own !== null) {
    return { kind: KINDS[own.outcome] ?? "cannot-say", headline: own.outcome, words: withoutStop(own.words) };
  }
  const kind = KINDS[route.outlook] ?? "cannot-say";
  if (plan.chosen === null) {
    const of = plan.routes.length === 1 ? "the only route" : `the best of ${plan.routes.length} routes`;
    return { kind, headline: route.outlook, words: `by ${of}` };
  }
  const driven = standing === "making" ? "the drive is being simulated" : null;
  return { kind, headline: route.outlook, words: driven };
}

const withoutStop = (words: string | null): string | null => words?.replace(/\.$/, "") ?? null;

/** Return length, angle and hits of the needle's path as text. */
export function needleText(leg: NeedleLeg): string {
  const moved = leg.hit_share_moved === null ? "" : ` (${share(leg.hit_share_moved)} if moved)`;
  const hits = leg.hit_share === null ? "hits not known without a drive" : `hits ${share(leg.hit_share)}${moved}`;
  return `${mm(leg.to_target_mm, 0)} to the target, ${fixed(leg.angle_deg)}\u00b0 to the airway, ${hits}`;
}

/** Maximum length, mm, of the needle's path inside a vessel that counts as passing beside the vessel. */
const THROUGH_MM = 0.05;

/** Return the vessel nearest to the needle as text; `warns` is true for a vessel on the way or within the margin. */
export function vesselText(leg: NeedleLeg, marginMm: number): { text: string; warns: boolean } {
  const inside = leg.crossed
    .filter(({ tissue }) => tissue === "vessel")
    .reduce((sum, { from_mm, to_mm }) => sum + to_mm - from_mm, 0);
  if (inside > THROUGH_MM) return { text: `on the needle\u2019s way, ${mm(inside, 0)} through it`, warns: true };
  if (leg.vessel_mm === null) return { text: "none seen near the needle", warns: false };
  return { text: `${mm(leg.vessel_mm)} from the needle`, warns: leg.vessel_mm < marginMm };
}
