/** The way from a CT to a rehearsed route: steps in order, each revisitable. */

export const STEPS = ["open", "check", "airways", "target", "route", "rehearse", "share"] as const;
export type Step = (typeof STEPS)[number];

export interface StepWords {
  title: string;
  /** What the step is for, in a tooltip. */
  words: string;
}

export const STEP_WORDS: Readonly<Record<Step, StepWords>> = {
  open: { title: "Open", words: "The case: what is open, and how to open another" },
  check: { title: "Check", words: "Is this CT good enough? Findings, other series, grey window" },
  airways: { title: "Airways", words: "The airway tree that was found, its root and threshold" },
  target: { title: "Target", words: "Mark where you want to go" },
  route: { title: "Route", words: "Choose the way, see its length and narrowest place" },
  rehearse: {
    title: "Rehearse",
    words: "Practise the route with a real bronchoscope's width and bend, and see what it touches",
  },
  share: {
    title: "Share",
    words: "Surface, lumen and centrelines as files",
  },
};
