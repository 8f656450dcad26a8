/** Course: the learners of this machine, and the learning curves of the chosen one. */

import type { CourseAttemptInfo, CourseInfo, ReferenceScores } from "../wire/messages";
import { fixed } from "./format";
import { clock } from "./playing";

/** A point of a learning curve. */
export interface CurvePoint {
  /** Number of the attempt, from 1. */
  readonly attempt: number;
  readonly value: number;
  /** Whether the attempt counts in the verdict. */
  readonly counts: boolean;
}

/** A learning curve: one measure over the attempts, with the published values of groups. */
export interface Curve {
  readonly title: string;
  readonly points: readonly CurvePoint[];
  /** Values of groups, which are no pass marks; none for a measure without published values. */
  readonly marks: readonly { readonly group: string; readonly value: number }[];
  readonly text: (value: number) => string;
}

/** Return the learning curves of the chosen learner over the inspections of all segments. */
export function curvesOf({ attempts }: CourseInfo, groups: readonly ReferenceScores[]): readonly Curve[] {
  const inspections = attempts.filter((one) => one.is_inspection);
  const curve = (
    title: string,
    of: (one: CourseAttemptInfo) => number | null,
    mark: ((one: ReferenceScores) => number) | null,
    text: (value: number) => string = (value) => fixed(value),
  ): Curve => ({
    title,
    points: inspections.flatMap((one) => {
      const value = of(one);
      return value === null ? [] : [{ attempt: one.number, value, counts: one.counts }];
    }),
    marks: mark === null ? [] : groups.map((one) => ({ group: one.group, value: mark(one) })),
    text,
  });
  return [
    curve(
      "Diagnostic completeness",
      (one) => one.published.num_seen,
      (one) => one.num_seen,
    ),
    curve(
      "Structured progress",
      (one) => one.published.num_progressions,
      (one) => one.num_progressions,
    ),
    curve(
      "Procedure time",
      (one) => one.published.time_s,
      (one) => one.time_s,
      clock,
    ),
    curve("Wall contacts", (one) => one.num_contacts, null),
    curve(
      "Lumen in the middle",
      (one) => 100 * one.middle_share,
      null,
      (value) => `${fixed(value)} %`,
    ),
  ];
}

/** Return the place of each point in a box, px: attempts from left to right, the largest value at the top. */
export function curvePlaces(curve: Curve, width: number, height: number): readonly { x: number; y: number }[] {
  const most = curveTop(curve);
  const last = Math.max(curve.points.length - 1, 1);
  return curve.points.map(({ value }, n) => ({ x: (width * n) / last, y: height * (1 - value / most) }));
}

/** Return the value at the top of a curve's box: the largest value of the curve and of the groups. */
export const curveTop = ({ points, marks }: Curve): number =>
  Math.max(...points.map(({ value }) => value), ...marks.map(({ value }) => value), 1e-9);

/** Return in one line what an attempt achieved. */
export function attemptText(one: CourseAttemptInfo): string {
  const result = one.is_inspection
    ? `${one.published.num_seen} seen, ${one.published.num_progressions} in order`
    : one.completed
      ? "completed"
      : `${one.num_steps_done} of ${one.num_steps} steps`;
  return `${result}, ${clock(one.published.time_s)}`;
}

/** Return whether an attempt counts, as text, with the reasons if it does not. */
export function countsText({ counts, is_inspection: isInspection, reasons }: CourseAttemptInfo): string {
  if (counts) return "yes";
  return isInspection || reasons.length > 0 ? `no: ${reasons.join("; ")}` : "not an inspection";
}
