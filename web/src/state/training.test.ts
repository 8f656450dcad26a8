import { describe, expect, it } from "vitest";
import type { FlightScore, QuizInfo, RunningTask, TaskInfo, TrainingMessage } from "../wire/messages";
import { INITIAL_STATE, reduce } from "./app-state";
import { SCORE_DEFINITIONS } from "./score-definitions";
import {
  answerText,
  attemptOf,
  hidesNames,
  outcomeText,
  progressText,
  publishedRows,
  timeText,
  trainingLayout,
  unmarkedRows,
} from "./training";

const TASK: TaskInfo = {
  name: "inspect-all",
  title: "Visit all segments",
  level: "intermediate",
  time_limit_s: 600,
  names_shown: false,
  tree_shown: false,
  ghost_shown: false,
  problem: null,
  is_own: false,
};
const RUNNING: RunningTask = {
  task: "inspect-all",
  flight: 3,
  elapsed_s: 12,
  num_steps: 18,
  steps_done: ["RB1"],
  next_step: "RB2",
  arrow_branches: [],
  message: null,
  is_warning: false,
  paused: false,
  learner: null,
};
const SCORE: FlightScore = {
  flight: 3,
  task: "inspect-all",
  task_title: "Visit all segments",
  is_inspection: true,
  completed: false,
  num_steps_done: 2,
  num_steps: 17,
  num_wrong: 0,
  published: { num_seen: 4, num_progressions: 2, time_s: 65, time_per_segment_s: 16.25, num_revisited: 1 },
  unmarked: { path_mm: 900, smoothness: null, num_contacts: 2, contact_s: 1.5, red_out_s: 0, middle_share: 0.5 },
  seen: ["RB1", "RB2", "RB3", "RB6"],
  not_seen: Array.from({ length: 13 }, (_, n) => `segment ${n}`),
  absent: ["RB7"],
  doubts: [],
  notes: [],
  moments: [],
  segments: [],
  timeline: [],
  clock_start_s: 0,
  clock_end_s: 65,
  comparison: [],
  comparison_moments: [],
};
const message = (parts: Partial<TrainingMessage>): TrainingMessage => ({
  type: "training",
  tasks: [TASK],
  running: null,
  quiz: null,
  scores: [],
  verdict: null,
  references: [],
  course: { stores: false, learners: [], chosen: null, attempts: [], problems: [] },
  task_folder: null,
  task_problems: [],
  classroom: [],
  ...parts,
});
const stateAfter = (...messages: readonly TrainingMessage[]) =>
  messages.reduce((state, one) => reduce(state, { kind: "server", message: one }), INITIAL_STATE);

describe("a running attempt", () => {
  it("shows the step Train in a page that is loaded during the attempt, also after its end", () => {
    expect(INITIAL_STATE.ui.step).not.toBe("train");
    const running = stateAfter(message({ running: RUNNING }));
    expect([running.ui.step, running.ui.panel]).toEqual(["train", "step"]);
    expect(stateAfter(message({ running: RUNNING }), message({})).ui.step).toBe("train");
    expect(stateAfter(message({})).ui.step).toBe("open");
  });

  it("hides names only while its task hides them", () => {
    expect(hidesNames(INITIAL_STATE)).toBe(false);
    expect(hidesNames(stateAfter(message({ running: RUNNING })))).toBe(true);
    expect(hidesNames(stateAfter(message({ tasks: [{ ...TASK, names_shown: true }], running: RUNNING })))).toBe(false);
  });

  it("is the same object for the same message, as components require", () => {
    const state = stateAfter(message({ running: RUNNING }));
    expect(attemptOf(state)).not.toBeNull();
    expect(attemptOf({ ...state })).toBe(attemptOf(state));
  });

  it("ends a full view and the tour when it begins, and leaves a full view that is opened later", () => {
    const full = reduce(stateAfter(message({})), { kind: "ui", change: { full: "axial", tourAt: 2 } });
    const begun = reduce(full, { kind: "server", message: message({ running: RUNNING }) });
    expect([begun.ui.full, begun.ui.tourAt]).toEqual([null, null]);
    const later = reduce(begun, { kind: "ui", change: { full: "outside" } });
    expect(reduce(later, { kind: "server", message: message({ running: RUNNING }) }).ui.full).toBe("outside");
  });

  it("states its progress, the next step, and the time left", () => {
    const attempt = attemptOf(stateAfter(message({ running: RUNNING })));
    expect(attempt).not.toBeNull();
    if (attempt === null) return;
    expect(progressText(attempt)).toBe("1 of 18, next: RB2");
    expect(timeText(attempt, 15)).toBe("9:45.0 left");
    expect(timeText(attempt, 700)).toBe("0:00.0 left");
    expect(timeText({ ...attempt, task: { ...TASK, time_limit_s: null } }, 15)).toBe("0:15.0");
  });
});

describe("a quiz", () => {
  const quiz: QuizInfo = {
    kind: "name-opening",
    number: 1,
    num_questions: 10,
    choices: ["RB6", "RB7"],
    lps_from_tip: [1, 0, 0, 10, 0, 1, 0, 20, 0, 0, 1, 30, 0, 0, 0, 1],
    num_right: 0,
    given: null,
    answer: null,
    is_over: false,
  };

  it("hides names and shows the airway view alone", () => {
    const state = stateAfter(message({ quiz }));
    expect(hidesNames(state)).toBe(true);
    expect(trainingLayout(state)).toBe("alone");
    expect(trainingLayout(INITIAL_STATE)).toBeUndefined();
  });

  it("states the right name after a wrong answer, and nothing before the answer", () => {
    expect(answerText(quiz)).toBeNull();
    expect(answerText({ ...quiz, given: "RB7", answer: "RB6" })).toBe("No: this is RB6, not RB7");
    expect(answerText({ ...quiz, given: "RB6", answer: "RB6" })).toBe("Right: RB6");
  });
});

describe("the score of an attempt", () => {
  it("is opened once it is known, and not before", () => {
    const ended = stateAfter(message({ running: RUNNING }), message({}));
    expect(ended.ui.openScore).toBeNull();
    const scored = reduce(ended, { kind: "server", message: message({ scores: [SCORE] }) });
    expect(scored.ui.openScore).toBe(3);
  });

  it("is not opened for a flight that was scored without an attempt in this window", () => {
    expect(stateAfter(message({ scores: [SCORE] })).ui.openScore).toBeNull();
  });

  it("states the denominator of the case beside 18", () => {
    const rows = publishedRows(SCORE, []);
    expect(rows[0]?.value).toBe("4\u00a0of\u00a018; this case has 17");
    const whole = { ...SCORE, not_seen: [...SCORE.not_seen, "RB7"], absent: [] };
    expect(publishedRows(whole, [])[0]?.value).toBe("4\u00a0of\u00a018");
  });

  it("shows published values beside published scores only", () => {
    const group = {
      group: "novices (10)",
      num_seen: 9,
      num_progressions: 2,
      time_s: 281,
      time_per_segment_s: 32,
      source: "study",
    };
    expect(publishedRows(SCORE, [group]).map((row) => row.references)).toEqual([
      ["9"],
      ["2"],
      ["4:41.0"],
      ["32.0 s"],
      [""],
    ]);
    expect(unmarkedRows(SCORE).every((row) => row.references.length === 0)).toBe(true);
  });

  it("names wrong segments only where a task has them", () => {
    const titles = (score: FlightScore) => unmarkedRows(score).map((row) => row.title);
    expect(titles(SCORE)).not.toContain("Wrong segments or branches");
    expect(titles({ ...SCORE, is_inspection: false })).toContain("Wrong segments or branches");
  });

  it("states whether the task was completed", () => {
    expect(outcomeText(SCORE)).toBe("Not completed: 2 of 17 steps");
    expect(outcomeText({ ...SCORE, completed: true })).toBe("All segments of this case visited");
    expect(outcomeText({ ...SCORE, completed: true, is_inspection: false })).toBe("Completed");
  });
});

describe("the definitions of the score screen", () => {
  it("state the limits of a high-error event, that they are Carina's, and that no threshold is published", () => {
    const words = SCORE_DEFINITIONS.find(({ title }) => title === "High-error events")?.words ?? "";
    for (const part of ["at least 0.5 s", "more than 5 mm", "less than 0.5 s apart", "Carina's", "No threshold is"]) {
      expect(words).toContain(part);
    }
  });

  it("have different titles", () => {
    const titles = SCORE_DEFINITIONS.map(({ title }) => title);
    expect(new Set(titles).size).toBe(titles.length);
  });
});
