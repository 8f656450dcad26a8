/** Training: the running attempt, and the rows of the score table with their definitions. */

import type { FlightScore, QuizInfo, ReferenceScores, RunningTask, TaskInfo, TrainingMessage } from "../wire/messages";
import type { AppState } from "./app-state";
import type { ExpertPath } from "./expert";
import { fixed, mm } from "./format";
import { clock } from "./playing";

/** The attempt that is being flown, and its task. */
export interface Attempt {
  readonly running: RunningTask;
  readonly task: TaskInfo;
}

/** The attempt of each message. A component needs the same object for the same message. */
const attempts = new WeakMap<TrainingMessage, Attempt | null>();

/** Return the running attempt, the same object for the same message; null without one. */
export function attemptOf({ training }: AppState): Attempt | null {
  if (training === null) return null;
  const known = attempts.get(training);
  if (known !== undefined) return known;
  const { running } = training;
  const task = training.tasks.find((one) => one.name === running?.task);
  const attempt = running === null || task === undefined ? null : { running, task };
  attempts.set(training, attempt);
  return attempt;
}

/** Return whether an attempt whose task hides the names of branches, or a quiz about these names, is running. */
export const hidesNames = (state: AppState): boolean =>
  attemptOf(state)?.task.names_shown === false || quizOf(state) !== null;

/** Return the running quiz; null without one. */
export const quizOf = ({ training }: AppState): QuizInfo | null => training?.quiz ?? null;

/**
 * Return the layout of the window during an attempt or a quiz: the airway view alone, with the tree or with slices; else
 * undefined.
 */
export function trainingLayout(state: AppState): "alone" | "with-tree" | "with-slices" | undefined {
  const attempt = attemptOf(state);
  if (attempt !== null) return attempt.task.tree_shown ? "with-tree" : "alone";
  const quiz = quizOf(state);
  return quiz === null ? undefined : quiz.kind === "slices" ? "with-slices" : "alone";
}

/** Return the number of the flight that is marked as the expert's; null without one. */
export const expertFlight = ({ flights }: AppState): number | null =>
  flights.find((flight) => flight.is_expert)?.number ?? null;

/** Return the expert's path while another flight is replayed, or during a task with the ghost as a hint; null otherwise. */
export function shownExpert(state: AppState): ExpertPath | null {
  const { expertPath } = state.ui;
  if (expertPath === null || expertPath.flight !== expertFlight(state)) return null;
  const replayed = state.pose?.flight?.number ?? null;
  const isOther = replayed !== null && replayed !== expertPath.flight;
  return isOther || attemptOf(state)?.task.ghost_shown === true ? expertPath.path : null;
}

/** Maximum difference of a number of two poses that are the same, mm or without unit. */
const SAME_POSE = 0.01;

/** Return whether the tip has the pose of the present question of the quiz. */
export function isAtQuestion({ pose }: AppState, quiz: QuizInfo): boolean {
  return pose?.lps_from_camera.every((value, n) => Math.abs(value - (quiz.lps_from_tip[n] ?? 0)) < SAME_POSE) ?? false;
}

/** Return the question of a quiz as text. */
export const questionText = ({ kind }: QuizInfo): string => QUESTIONS[kind];

const QUESTIONS: Readonly<Record<QuizInfo["kind"], string>> = {
  "name-opening": "Which segment is behind the opening in the middle?",
  "where-are-you": "In which segment is the tip?",
  slices: "The three slices meet in a bronchus beyond this fork. Which opening leads there?",
};

/** Return whether the answer to the present question is right, as text; null before the answer. */
export function answerText({ given, answer }: QuizInfo): string | null {
  if (given === null || answer === null) return null;
  return given === answer ? `Right: ${answer}` : `No: this is ${answer}, not ${given}`;
}

/** Return the step that follows in the order of the task, or the progress, as a text for the trainee. */
export function progressText({ running }: Attempt): string {
  const done = `${running.steps_done.length} of ${running.num_steps}`;
  if (running.num_steps === 0) return "Advance into the airways";
  return running.next_step === null ? done : `${done}, next: ${running.next_step}`;
}

/** Return the time that is left, or the elapsed time of a task without a limit. */
export function timeText({ running, task }: Attempt, elapsedS: number): string {
  const limit = task.time_limit_s;
  return limit === null ? clock(Math.max(elapsedS, running.elapsed_s)) : `${clock(Math.max(limit - elapsedS, 0))} left`;
}

/** A row of the table of scores. */
export interface ScoreRow {
  readonly title: string;
  readonly value: string;
  /** Definition of the score, with its source. */
  readonly words: string;
  /** The published values of each group, in the order of the groups; none for measures without published values. */
  readonly references: readonly string[];
}

/** Number of segments that the published scores count. */
const NUM_PUBLISHED = 18;

/** Return the rows of the table of published scores. */
export function publishedRows(score: FlightScore, groups: readonly ReferenceScores[]): readonly ScoreRow[] {
  const { published: found } = score;
  const numCase = score.seen.length + score.not_seen.length;
  const ofCase = numCase === NUM_PUBLISHED ? "" : `; this case has ${numCase}`;
  return [
    {
      title: "Diagnostic completeness",
      value: `${found.num_seen}\u00a0of\u00a0${NUM_PUBLISHED}${ofCase}`,
      words: "Number of segments seen. Copenhagen group; Carina's definition of seen is in the guide on training.",
      references: groups.map((one) => fixed(one.num_seen)),
    },
    {
      title: "Structured progress",
      value: `${found.num_progressions}\u00a0of\u00a0${NUM_PUBLISHED}${ofCase}`,
      words:
        "Number of moves from one segment to the next in ascending order. " +
        "Cold 2020, J Thorac Dis, 10.21037/jtd-20-2181.",
      references: groups.map((one) => fixed(one.num_progressions)),
    },
    {
      title: "Procedure time",
      value: clock(found.time_s),
      words: "Time from the start of the clock to the end of the attempt. Copenhagen group.",
      references: groups.map((one) => clock(one.time_s)),
    },
    {
      title: "Mean intersegmental time",
      value: found.time_per_segment_s === null ? "no segment seen" : seconds(found.time_per_segment_s),
      words: "Procedure time divided by the number of segments seen. Copenhagen group.",
      references: groups.map((one) => seconds(one.time_per_segment_s)),
    },
    {
      title: "Segments revisited",
      value: fixed(found.num_revisited),
      words: "Number of times that the tip entered a segment again. Agbontaen 2025, Crit Care Med.",
      references: groups.map(() => ""),
    },
  ];
}

/** Return the rows of the table of measures for which no threshold is published. */
export function unmarkedRows({ unmarked: found, is_inspection, ...score }: FlightScore): readonly ScoreRow[] {
  const row = (title: string, value: string, words: string): ScoreRow => ({ title, value, words, references: [] });
  return [
    ...(is_inspection
      ? []
      : [
          row(
            "Wrong segments or branches",
            fixed(score.num_wrong),
            "Visited or entered before the task was completed. Definition of Carina.",
          ),
        ]),
    row(
      "Path of the tip",
      mm(found.path_mm, 0),
      "Sum of the movements of the tip. Economy of path separates experts from novices: Moorthy 2003.",
    ),
    row(
      "Smoothness",
      found.smoothness === null ? "not known" : fixed(found.smoothness, 1),
      "Minus the logarithm of the dimensionless jerk; larger is smoother. Hogan and Sternad 2009, from general knowledge.",
    ),
    row(
      "Wall contacts",
      `${found.num_contacts} (${seconds(found.contact_s)})`,
      "Number and duration of touches: the tip is within 0.1 mm of the wall, a definition of Carina. A touch by the " +
        "simulated breathing alone counts only from the next movement of the tip. The force is not measured. Wall " +
        "collisions separate experts from novices: Moorthy 2003.",
    ),
    row(
      "Red-out",
      seconds(found.red_out_s),
      "Time with the lens so near to the wall that the picture is at least half red. Definition of Carina.",
    ),
    row(
      "Lumen in the middle",
      `${fixed(100 * found.middle_share)} %`,
      "Share of the time with the centreline 10 mm ahead within a quarter of the field of view from the middle, a " +
        "definition of Carina. Share of time on the axis: Nature Communications 2023, s41467-023-44385-7.",
    ),
  ];
}

const seconds = (value: number): string => `${fixed(value, 1)} s`;

/** Return in one line whether the task was completed. */
export function outcomeText(score: FlightScore): string {
  if (score.completed) return score.is_inspection ? "All segments of this case visited" : "Completed";
  return `Not completed: ${score.num_steps_done} of ${score.num_steps} steps`;
}
