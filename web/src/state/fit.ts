/**
 * Fit of an instrument on a route: the largest sphere in the lumen is compared with the diameter that the instrument
 * needs.
 */

import type { RouteInfo, Scope } from "../wire/messages";

type Widths = Pick<RouteInfo, "wall_mm" | "cumulative_mm">;

/**
 * Return the first place of the route where the lumen is narrower than needed (`Scope.fit_mm`); null if the instrument
 * reaches the end.
 */
export function firstTooNarrow(route: Widths, neededMm: number): { pathMm: number; diameterMm: number } | null {
  const index = route.wall_mm.findIndex((ball) => 2 * ball < neededMm);
  if (index < 0) return null;
  return { pathMm: route.cumulative_mm[index] ?? 0, diameterMm: 2 * (route.wall_mm[index] ?? 0) };
}

/** Return the instruments that reach the route's end, thickest first, because the thickest has the widest channel. */
export function thatPass(route: Widths, scopes: readonly Scope[]): Scope[] {
  return scopes
    .filter((scope) => firstTooNarrow(route, scope.fit_mm) === null)
    .sort((a, b) => b.tip_mm - a.tip_mm || a.title.localeCompare(b.title));
}

/** Return the instrument that advances farthest among those that do not reach the end; null without instruments. */
export function comesFarthest(route: Widths, scopes: readonly Scope[]): { scope: Scope; pathMm: number } | null {
  let best: { scope: Scope; pathMm: number } | null = null;
  for (const scope of scopes) {
    const pathMm = firstTooNarrow(route, scope.fit_mm)?.pathMm ?? Number.POSITIVE_INFINITY;
    if (best === null || pathMm > best.pathMm) best = { scope, pathMm };
  }
  return best;
}
