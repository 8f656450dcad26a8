import { describe, expect, it } from "vitest";
import type { CourseAttemptInfo, CourseInfo, ReferenceScores } from "../wire/messages";
import { attemptText, countsText, curvePlaces, curvesOf } from "./course";

const attempt = (values: Partial<CourseAttemptInfo>): CourseAttemptInfo => ({
  number: 1,
  task: "inspect-all",
  title: "Visit all segments",
  is_inspection: true,
  completed: false,
  num_steps_done: 4,
  num_steps: 18,
  counts: true,
  reasons: [],
  published: { num_seen: 9, num_progressions: 3, time_s: 240, time_per_segment_s: 26, num_revisited: 0 },
  num_contacts: 5,
  middle_share: 0.5,
  ...values,
});
const COURSE: CourseInfo = {
  stores: true,
  learners: [],
  chosen: "Blue heron",
  attempts: [
    attempt({}),
    attempt({ number: 2, is_inspection: false, completed: true }),
    attempt({
      number: 3,
      published: { num_seen: 18, num_progressions: 3, time_s: 120, time_per_segment_s: 7, num_revisited: 0 },
      counts: false,
    }),
  ],
  problems: [],
};
const ROBOT: ReferenceScores = {
  group: "autonomous robot",
  num_seen: 18,
  num_progressions: 18,
  time_s: 124,
  time_per_segment_s: 7,
  source: "Cold 2025",
};

describe("learning curves", () => {
  it("A curve has a point for each inspection, and the published values of groups.", () => {
    const [seen, , time, contacts] = curvesOf(COURSE, [ROBOT]);
    expect(seen?.points).toEqual([
      { attempt: 1, value: 9, counts: true },
      { attempt: 3, value: 18, counts: false },
    ]);
    expect(seen?.marks).toEqual([{ group: "autonomous robot", value: 18 }]);
    expect(time?.text(120)).toBe("2:00.0");
    expect(contacts?.marks).toEqual([]);
  });

  it("The largest value is at the top, and the first attempt at the left.", () => {
    const [seen] = curvesOf(COURSE, []);
    expect(seen && curvePlaces(seen, 100, 50)).toEqual([
      { x: 0, y: 25 },
      { x: 100, y: 0 },
    ]);
  });

  it("states why an attempt at another task does not count", () => {
    expect(countsText(attempt({ is_inspection: false, counts: false }))).toBe("not an inspection");
    expect(countsText(attempt({ is_inspection: false, counts: false, reasons: ["paused once"] }))).toBe(
      "no: paused once",
    );
    expect(countsText(attempt({}))).toBe("yes");
  });

  it("An attempt at another task states its steps.", () => {
    expect(attemptText(attempt({ is_inspection: false }))).toBe("4 of 18 steps, 4:00.0");
    expect(attemptText(attempt({}))).toBe("9 seen, 3 in order, 4:00.0");
  });
});
