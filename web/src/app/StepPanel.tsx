/** Panel of the current workflow step. Each step has one primary action. */

import { STEP_TEXTS } from "../state/steps";
import { trainingLayout } from "../state/training";
import { Citation } from "./Citation";
import { useApp } from "./context";
import { Jobs } from "./Jobs";
import { AirwaysStep } from "./steps/AirwaysStep";
import { CheckStep } from "./steps/CheckStep";
import { OpenStep } from "./steps/OpenStep";
import { RehearseStep } from "./steps/RehearseStep";
import { RouteStep } from "./steps/RouteStep";
import { ShareStep } from "./steps/ShareStep";
import { TargetStep } from "./steps/TargetStep";
import { TrainStep } from "./steps/TrainStep";

/** Render the panel of the current workflow step. */
export function StepPanel() {
  // During an attempt or a quiz the other steps could end it, and would show what the task hides.
  const step = useApp((state) => (trainingLayout(state) === undefined ? state.ui.step : "train"));
  const citation = useApp((state) => state.session?.case?.citation ?? null);
  return (
    <section className="step-panel" aria-label={STEP_TEXTS[step].title}>
      <Jobs />
      <h2>{STEP_TEXTS[step].title}</h2>
      {/* The key gives each step a new element, so that the scroll position is reset when the step changes. */}
      <div key={step} className="step-body">
        {body(step)}
      </div>
      {citation === null ? null : <Citation from={citation} />}
    </section>
  );
}

function body(step: keyof typeof STEP_TEXTS) {
  switch (step) {
    case "open":
      return <OpenStep />;
    case "check":
      return <CheckStep />;
    case "airways":
      return <AirwaysStep />;
    case "target":
      return <TargetStep />;
    case "route":
      return <RouteStep />;
    case "rehearse":
      return <RehearseStep />;
    case "train":
      return <TrainStep />;
    case "share":
      return <ShareStep />;
  }
}
