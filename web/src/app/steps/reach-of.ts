/** Selection of the scope and the tool for which the reach is computed. */

import { planOf } from "../../state/plan";
import { useApp } from "../context";

const USUAL = { scope: "thin", tool: "needle-21g" } as const;

/** Return the scope and the tool of the selected target's plan; without a plan, the scope of the airway view. */
export function useReachOf(): { scope: string; tool: string } {
  const plan = useApp(
    (state) => planOf(state.plans, state.route?.target_id ?? null) ?? state.plans?.targets[0] ?? null,
  );
  const looked = useApp((state) => state.look.scope);
  return plan === null
    ? { scope: looked ?? USUAL.scope, tool: USUAL.tool }
    : { scope: plan.options.scope, tool: plan.options.tool };
}
