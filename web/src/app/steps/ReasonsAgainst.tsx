/** List of everything against a plan; report, sheet, command line and plan.json list the same in the same order. */

import { useId } from "react";
import type { TargetPlan } from "../../wire/messages";
import { Icon } from "../icons";

/** Render the reasons against a plan, in the order of the server. */
export function ReasonsAgainst({ reasons }: { reasons: TargetPlan["reasons"] }) {
  const title = useId();
  if (reasons.length === 0) return null;
  return (
    <section aria-labelledby={title}>
      <h3 id={title}>Against this plan, and its limits</h3>
      <ul className="reasons" data-testid="reasons">
        {reasons.map(([code, words, severity]) => (
          <li
            key={`${code} ${words}`}
            className={severity === "stop" ? "error-text" : undefined}
            data-testid="reason"
            data-code={code}
          >
            {severity === "stop" ? <Icon name="warning" /> : null} {words}
          </li>
        ))}
      </ul>
    </section>
  );
}
