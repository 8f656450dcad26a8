/** Chart of a branch: lumen diameter with its error against the distance along the branch, in chart coordinates. */

import type { BranchProfile } from "../wire/messages";

/** A cross-section of the branch as a point of the chart. */
export interface ProfilePoint {
  readonly atMm: number;
  readonly lumenMm: number;
  /** Error of the diameter, mm; null if it is unknown. */
  readonly errorMm: number | null;
  /** Whether the section is at a fork, where it does not measure a single airway. */
  readonly atJunction: boolean;
}

/** Return the sections of a branch that have a measured lumen. */
export function measuredPoints(profile: BranchProfile): ProfilePoint[] {
  return profile.at_mm.flatMap((atMm, n) => {
    const lumenMm = profile.lumen_mm[n] ?? null;
    if (lumenMm === null) return [];
    return [{ atMm, lumenMm, errorMm: profile.lumen_error_mm[n] ?? null, atJunction: profile.at_junction[n] ?? false }];
  });
}

/** Scale of the chart, from mm to px. */
export interface ChartScale {
  readonly lengthMm: number;
  readonly topMm: number;
  /** Convert a distance along the branch, mm, to a horizontal position in the chart, px. */
  x(atMm: number): number;
  y(lumenMm: number): number;
  /** Diameters at which the chart has a grid line, mm. */
  readonly ticksMm: readonly number[];
}

const STEPS_MM = [0.5, 1, 2, 5, 10, 20] as const;

/** Return the scale of a chart with the given points and the given size in px. */
export function chartScale(points: readonly ProfilePoint[], width: number, height: number): ChartScale {
  const lengthMm = Math.max(...points.map((point) => point.atMm), 1e-3);
  const most = Math.max(...points.map((point) => point.lumenMm + (point.errorMm ?? 0)), 0.5);
  // The diameter axis starts at 0, so that the relative size of a narrowing is visible.
  const step = STEPS_MM.find((mm) => most / mm <= 3.5) ?? 50;
  const topMm = Math.ceil(most / step) * step;
  return {
    lengthMm,
    topMm,
    x: (atMm) => (width * atMm) / lengthMm,
    y: (lumenMm) => height * (1 - lumenMm / topMm),
    ticksMm: Array.from({ length: Math.round(topMm / step) + 1 }, (_, n) => n * step),
  };
}

/** Return runs of neighbouring sections outside forks, so that the chart draws no line across a fork. */
export function runsOf(points: readonly ProfilePoint[]): ProfilePoint[][] {
  const runs: ProfilePoint[][] = [];
  let run: ProfilePoint[] = [];
  for (const point of points) {
    if (!point.atJunction) {
      run.push(point);
      continue;
    }
    if (run.length > 0) runs.push(run);
    run = [];
  }
  if (run.length > 0) runs.push(run);
  return runs;
}

/** Return the section nearest to a position along the branch; null for an empty list. */
export function nearestSection(points: readonly ProfilePoint[], atMm: number): ProfilePoint | null {
  return points.reduce<ProfilePoint | null>(
    (best, point) => (best === null || Math.abs(point.atMm - atMm) < Math.abs(best.atMm - atMm) ? point : best),
    null,
  );
}
