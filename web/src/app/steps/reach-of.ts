/** The instrument and the tool whose reach is asked for. */

import { planOf } from "../../state/plan";
import { useApp } from "../context";

const USUAL = { scope: "thin", tool: "needle-21g" } as const;

/** As the target is planned with; without a plan the scope that is looked through. */
export function useReachOf(): { scope: string; tool: string } {
  const plan = useApp(
    (state) => planOf(state.plans, state.route?.target_id ?? null) ?? state.plans?.targets[0] ?? null,
  );
  const looked = useApp((state) => state.look.scope);
  return plan === null
    ? { scope: looked ?? USUAL.scope, tool: USUAL.tool }
    : { scope: plan.options.scope, tool: plan.options.tool };
}
