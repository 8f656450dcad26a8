/** The steps of the workflow from a CT to a rehearsed route, in order; the user can return to each step. */

/** Names of the workflow steps in order. */
export const STEPS = ["open", "check", "airways", "target", "route", "rehearse", "train", "share"] as const;
/** Name of a workflow step. */
export type Step = (typeof STEPS)[number];

/** Title and tooltip of a workflow step. */
export interface StepTexts {
  title: string;
  /** Purpose of the step, shown as its tooltip. */
  words: string;
}

/** Title and tooltip of each workflow step. */
export const STEP_TEXTS: Readonly<Record<Step, StepTexts>> = {
  open: { title: "Open", words: "Details of the open case; open another case here" },
  check: { title: "Check", words: "Is this CT good enough? Findings, other series, window / level" },
  airways: { title: "Airways", words: "The segmented airway tree, its start point and threshold" },
  target: { title: "Target", words: "Mark where you want to go" },
  route: { title: "Route", words: "Choose a route; see its length and narrowest point" },
  rehearse: {
    title: "Rehearse",
    words: "Rehearse the route with the diameter and bend of a real bronchoscope, and see where it touches the wall",
  },
  train: { title: "Train", words: "Fly tasks with a simulated bronchoscope, and see your scores" },
  share: {
    title: "Share",
    words: "Save the surface, lumen and centrelines to files",
  },
};
