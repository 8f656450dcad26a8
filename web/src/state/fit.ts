/** Fit of instruments on a route: whether they pass its narrowest measured place, as plans and verdicts state it. */

import type { RouteInfo, Scope, ScopeFit } from "../wire/messages";

type Fits = Pick<RouteInfo, "scope_fits">;

/** Return whether an instrument passes the narrowest place of a route; null until the airways are measured. */
export function fitOf(route: Fits, scopeName: string): ScopeFit["fit"] | null {
  return route.scope_fits.find((one) => one.scope === scopeName)?.fit ?? null;
}

/** Return the instruments that pass the narrowest place, thickest first, because the thickest has the widest channel. */
export function thatFit(route: Fits, scopes: readonly Scope[]): Scope[] {
  return scopes
    .filter((scope) => fitOf(route, scope.name) === "fits")
    .sort((a, b) => b.tip_mm - a.tip_mm || a.title.localeCompare(b.title));
}

/** Text of a fit, for the row *Scope reaches*; `end` and `narrowest` are the places as text. */
export function reachText(fit: ScopeFit["fit"], end: string, narrowest: string): string {
  if (fit === "fits") return `the end, ${end}`;
  return fit === "may fit" ? `maybe the end, ${end}` : `no farther than ${narrowest}`;
}
