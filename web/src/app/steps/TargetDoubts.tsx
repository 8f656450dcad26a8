/**
 * Doubts whether a target is a nodule, and the question whether to plan the target despite them. The question is not
 * modal, because the user must look at the target in the slices to answer it.
 */

import { useEffect, useId, useRef } from "react";
import { sentence } from "../../state/format";
import type { Target, TargetPlan } from "../../wire/messages";
import { useStation } from "../context";
import { Act } from "../controls";
import { Icon } from "../icons";

/** Render the doubts of a target; with a doubt that is not confirmed, also the question. */
export function TargetDoubts({ target, plan }: { target: Target; plan: TargetPlan }) {
  const station = useStation();
  const title = useId();
  const question = useRef<HTMLDivElement>(null);
  const isUnconfirmed = plan.unconfirmed.length > 0;
  // The column may end above the card, and the user would wait for routes without seeing the question.
  useEffect(() => {
    if (isUnconfirmed) question.current?.scrollIntoView({ block: "nearest" });
  }, [isUnconfirmed]);
  if (plan.doubts.length === 0) return null;
  const open = plan.unconfirmed;
  const reasons = plan.doubts.map(([code, words]) => (
    <span key={code} className="warning-text" data-testid="target-doubt" data-code={code}>
      <Icon name="warning" /> {sentence(words)}
    </span>
  ));
  if (open.length === 0) return reasons;
  return (
    <div ref={question} className="doubt" role="alertdialog" aria-labelledby={title} data-testid="target-question">
      <strong id={title}>Is {target.name} the nodule that you want to plan?</strong>
      {reasons}
      <span className="quiet">Look at it in the slices. Routes are planned after your confirmation.</span>
      <span className="row">
        <Act
          label="Plan it"
          words="Confirm that this is the target. The doubts stay in the plan and in its report."
          testId="confirm-target"
          onPress={() => station.send({ type: "confirm_target", target_id: target.target_id, doubts: open })}
        />
        <Act
          kind="quiet"
          label="Remove"
          words={`Remove ${target.name}`}
          testId="reject-target"
          onPress={() => station.send({ type: "remove_target", target_id: target.target_id })}
        />
      </span>
    </div>
  );
}
