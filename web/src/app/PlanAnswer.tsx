/**
 * Answer of a plan above the airway picture: whether the target is reached, the needle, the nearest vessel, the doubts, and
 * the print button. The panel of the step contains the details.
 */

import type { AppState } from "../state/app-state";
import { sentence } from "../state/format";
import { answeredPlan, answerOf, needleText, type ReachAnswer, vesselText } from "../state/plan-answer";
import type { Target, TargetPlan } from "../wire/messages";
import { useApp, useStation } from "./context";
import { Act } from "./controls";
import { ReasonsAgainst } from "./steps/ReasonsAgainst";

/** Return the plan whose answer the window shows above the airway picture; null without one. */
const shownPlan = (state: AppState): TargetPlan | null => (state.ui.full === null ? answeredPlan(state) : null);

/** Return whether the card above the airway picture contains the answer of a plan. */
export const useIsAnswered = (plan: TargetPlan): boolean =>
  useApp((state) => shownPlan(state)?.target_id === plan.target_id);

/** Render the answer of the plan that the user reads; nothing without such a plan, and nothing in full view. */
export function PlanAnswer() {
  const plan = useApp(shownPlan);
  const targets = useApp((state) => state.session?.targets ?? null);
  const target = targets?.find((one) => one.target_id === plan?.target_id) ?? null;
  return plan !== null && target !== null ? <Answer target={target} plan={plan} /> : null;
}

const MARKS: Readonly<Record<ReachAnswer["kind"], string>> = {
  reaches: "\u2713",
  "may-reach": "?",
  "does-not-reach": "\u2717",
  "cannot-say": "\u2013",
};

/**
 * Render whether the target is reached, the needle and the nearest vessel in a panel, for a plan whose answer is not in
 * the card above the picture. A list of reasons below it explains the answer, so that the answer itself has no
 * explanation.
 */
export function PanelAnswer({ plan }: { plan: TargetPlan }) {
  const answered = useIsAnswered(plan);
  return answered ? null : (
    <div className="panel-answer" data-testid="panel-answer">
      <Reach title="" plan={plan} explained={plan.reasons.length === 0} />
      <Facts plan={plan} />
    </div>
  );
}

/** Render whether the planned scope reaches the target; `title` precedes the answer. */
function Reach({ title, plan, explained }: { title: string; plan: TargetPlan; explained: boolean }) {
  const plans = useApp((state) => state.plans);
  const route = plan.routes[(plan.chosen ?? 1) - 1] ?? null;
  const scopes = useApp((state) => state.start?.scopes ?? null);
  const scope = scopes?.find((one) => one.name === plan.options.scope)?.title ?? plan.options.scope;
  const reach = answerOf(plan, plans?.verdicts ?? [], plans?.verdicts_standing ?? "unwanted");
  return (
    <div className={`reach ${reach.kind}`} role="status" data-testid="answer-reach">
      <span className="mark" aria-hidden="true">
        {MARKS[reach.kind]}
      </span>
      <div>
        <strong>{title === "" ? sentence(reach.headline) : `${title}: ${reach.headline}`}</strong>
        <span className="quiet">
          {reach.words === null || !explained ? "" : `${sentence(reach.words)}. `}
          {route === null ? "" : `${scope}, via ${route.branch_name}.`}
        </span>
      </div>
    </div>
  );
}

/** Render the needle's path and the nearest vessel of the chosen route, else of the best route. */
function Facts({ plan }: { plan: TargetPlan }) {
  const route = plan.routes[(plan.chosen ?? 1) - 1] ?? null;
  if (route === null) return null;
  const vessel = vesselText(route.leg, plan.options.vessel_margin_mm);
  return (
    <dl className="answer-facts numbers">
      <div>
        <dt>Needle</dt>
        <dd data-testid="answer-needle">{needleText(route.leg)}</dd>
      </div>
      <div>
        <dt>Vessel</dt>
        <dd data-testid="answer-vessel" className={vessel.warns ? "error-text" : undefined}>
          {vessel.text}
        </dd>
      </div>
    </dl>
  );
}

function Answer({ target, plan }: { target: Target; plan: TargetPlan }) {
  const station = useStation();
  const route = plan.routes[(plan.chosen ?? 1) - 1] ?? null;
  return (
    <section className="plan-answer" aria-label={`Answer for ${target.name}`} data-testid="plan-answer">
      {/* The list of reasons explains the answer. */}
      <Reach title={target.name} plan={plan} explained={plan.reasons.length === 0} />
      <Facts plan={plan} />
      {/* biome-ignore lint/a11y/noNoninteractiveTabindex: the keyboard scrolls a list that is longer than the card */}
      <section className="answer-doubts" data-testid="answer-doubts" aria-label="Doubts" tabIndex={0}>
        {route !== null && plan.reasons.length === 0 ? (
          <p className="quiet">No doubts about the target or this route.</p>
        ) : null}
        <ReasonsAgainst reasons={plan.reasons} />
      </section>
      <div className="answer-actions">
        {plan.chosen !== null ? (
          <Act
            kind="primary"
            icon="file"
            label="Print the plan"
            words="Make the report, and open it in a new tab to be printed"
            testId="print-plan"
            onPress={() => station.transfers.printPlan(target.target_id, "report")}
          />
        ) : route === null ? null : (
          <Act
            kind="primary"
            icon="play"
            label="Take the best route"
            words={`Via ${route.branch_name}; the other routes are under Route`}
            testId="answer-take-route"
            onPress={() => station.takePlannedRoute(target.target_id, 1)}
          />
        )}
        <Act
          kind="quiet"
          label="Details"
          words="Show the comparison of routes, the instruments and the turns in the Route panel"
          testId="answer-details"
          onPress={() => station.toStep("route")}
        />
      </div>
    </section>
  );
}
