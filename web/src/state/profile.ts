/** The chart of a branch: lumen against the way along it, with its error, as places in a picture of a given size. */

import type { BranchProfile } from "../wire/messages";

export interface ProfilePoint {
  readonly atMm: number;
  readonly lumenMm: number;
  /** Null where it is not known. */
  readonly errorMm: number | null;
  /** At a fork, where the section is no airway's width. */
  readonly atJunction: boolean;
}

/** Sections that have a lumen. */
export function measuredPoints(profile: BranchProfile): ProfilePoint[] {
  return profile.at_mm.flatMap((atMm, n) => {
    const lumenMm = profile.lumen_mm[n] ?? null;
    if (lumenMm === null) return [];
    return [{ atMm, lumenMm, errorMm: profile.lumen_error_mm[n] ?? null, atJunction: profile.at_junction[n] ?? false }];
  });
}

export interface ChartScale {
  readonly lengthMm: number;
  readonly topMm: number;
  /** From mm to px of the chart's inside. */
  x(atMm: number): number;
  y(lumenMm: number): number;
  /** Widths that get a line. */
  readonly ticksMm: readonly number[];
}

const STEPS_MM = [0.5, 1, 2, 5, 10, 20] as const;

export function chartScale(points: readonly ProfilePoint[], width: number, height: number): ChartScale {
  const lengthMm = Math.max(...points.map((point) => point.atMm), 1e-3);
  const most = Math.max(...points.map((point) => point.lumenMm + (point.errorMm ?? 0)), 0.5);
  // From 0: a narrowing looks as large as it is.
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

/** Runs of neighbouring sections that count, so that no line is drawn across a fork. */
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

/** The section nearest to a place; null where there are none. */
export function nearestSection(points: readonly ProfilePoint[], atMm: number): ProfilePoint | null {
  return points.reduce<ProfilePoint | null>(
    (best, point) => (best === null || Math.abs(point.atMm - atMm) < Math.abs(best.atMm - atMm) ? point : best),
    null,
  );
}
