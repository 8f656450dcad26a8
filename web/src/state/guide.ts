/** Stops of the hints of the first minute and of the tour: what each stop explains, and the element that it points at. */

import type { AppState } from "./app-state";
import type { Step } from "./steps";
import { trainingLayout } from "./training";

/** A stop of the hints or of the tour. */
export interface GuideStop {
  /** Selectors of the element that the stop points at; the first visible one is used. */
  readonly anchors: readonly string[];
  readonly title: string;
  readonly words: string;
  /** Step of the workflow that the tour shows at this stop; null leaves the step unchanged. */
  readonly step: Step | null;
}

const stop = (title: string, words: string, anchors: readonly string[], step: Step | null = null): GuideStop => ({
  title,
  words,
  anchors,
  step,
});

/** Call-outs that the first window of a user shows once. */
export const HINTS: readonly GuideStop[] = [
  stop("Fly", "Press Space. The tip flies to the next fork and stops in front of it.", [
    "[data-testid=fly-on]",
    ".airway-picture",
  ]),
  stop("Choose a branch", "Click a branch in the list or in a view. Your route then leads to this branch.", [
    ".branch-rows",
    "[data-cell=outside]",
  ]),
  stop(
    "Plan a target",
    "Open Target and mark a nodule. Carina plans the routes and states whether the scope reaches it.",
    ["[data-step=target]"],
  ),
];

/** Stops of the tour, which takes about two minutes. */
export const TOUR: readonly GuideStop[] = [
  stop(
    "The view from the tip",
    "Drag to look around, turn the wheel to move. A double click shows any view in full size.",
    [".airway-picture"],
    "airways",
  ),
  stop(
    "The route",
    "The bar shows the route and its forks. Drag the handle, or press Space to fly to the next fork.",
    [".path-bar"],
    "airways",
  ),
  stop(
    "The branches",
    "Click a branch: the route then leads to it. Press / to search by name, lobe or generation.",
    [".branches"],
    "airways",
  ),
  stop(
    "Slices and overviews",
    "A click moves the crosshair in all slices. The wheel scrolls through a slice, Ctrl and wheel zoom it.",
    [".side-views"],
    "airways",
  ),
  stop(
    "Mark a target",
    "Choose Mark a target and click a nodule in a slice. Carina measures the nodule and plans the routes.",
    ["[data-testid=arm-target]", "[data-step=target]"],
    "target",
  ),
  stop(
    "The answer",
    "A card above the airway view states whether the scope reaches the target, what is against the plan, and prints it.",
    [".plan-answer", "[data-step=route]"],
    "route",
  ),
  stop(
    "Rehearse",
    "A simulated scope bends, touches the wall and stops where the airway is too narrow. A wrong branch is reported.",
    ["[data-testid=rehearse]", "[data-step=rehearse]"],
    "rehearse",
  ),
  stop(
    "Train",
    "Fly a task with a simulated bronchoscope, then read its score. Two quizzes ask for the names of the airways.",
    ["[data-step=train]"],
    "train",
  ),
  stop(
    "Share",
    "Save the case, the airway surface and the centrelines. Nothing leaves this machine unless you share it.",
    ["[data-step=share]"],
    "share",
  ),
  stop("All keys", "The question mark lists all keys and mouse gestures. The tour can be started there again.", [
    "[data-testid=open-key-card]",
  ]),
];

/** Return whether the hints are due: a case with airways is open, and the user has not read the hints. */
export function hintsDue(state: AppState): boolean {
  const { start, session, watches, ui } = state;
  if (watches || ui.tourAt !== null || start === null || session === null) return false;
  // A task has its own instructions.
  if (trainingLayout(state) !== undefined) return false;
  return !start.hints_read && start.notice_accepted && session.case !== null && session.airways === "found";
}
