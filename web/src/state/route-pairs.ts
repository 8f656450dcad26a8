/** Rows of the table of instruments and routes, and the text about the best pair of an instrument and a route. */

import type { PlansMessage, RouteOffer, RoutePair, TargetPlan } from "../wire/messages";

/** One instrument with its verdict on each of the best routes; null where a verdict is missing. */
export interface PairRow {
  scope: string;
  title: string;
  available: boolean;
  cells: readonly (RoutePair | null)[];
}

/** Return the routes for which there are verdicts, in the order of the plan. */
export const pairedRoutes = (plan: TargetPlan, pairs: readonly RoutePair[]): RouteOffer[] =>
  plan.routes.filter((route) => pairs.some((pair) => pair.route === route.key));

/** Return a row for each instrument in the order of its best pair: available instruments first. */
export function pairRows(plan: TargetPlan, pairs: readonly RoutePair[]): PairRow[] {
  const routes = pairedRoutes(plan, pairs);
  const firsts = pairs.filter((pair, n) => pairs.findIndex((one) => one.scope === pair.scope) === n);
  return firsts.map(({ scope, title, available }) => ({
    scope,
    title,
    available,
    cells: routes.map((route) => pairs.find((one) => one.scope === scope && one.route === route.key) ?? null),
  }));
}

/** Return the best pair of a route and an available instrument that (may) reach the target; null if there is none. */
export const bestPair = (pairs: readonly RoutePair[]): RoutePair | null =>
  pairs.find((pair) => pair.available && ["reaches", "may reach"].includes(pair.outcome)) ?? null;

/** Return the number of a pair's route in the plan, from 1; 0 if the plan has no such route. */
export const routeNumber = (plan: TargetPlan, pair: RoutePair): number =>
  plan.routes.findIndex((route) => route.key === pair.route) + 1;

/** Return the answer for all pairs as text; null while the verdicts are computed and no pair reaches. */
export function pairsText(plan: TargetPlan, plans: PlansMessage): string | null {
  const pairs = plans.pairs;
  const best = bestPair(pairs);
  if (best !== null) {
    const route = plan.routes[routeNumber(plan, best) - 1];
    const branch = route === undefined ? "" : ` (${route.branch_name})`;
    return `${best.title} ${best.outcome} by route ${routeNumber(plan, best)}${branch}.`;
  }
  if (plans.pairs_standing !== "had") return null;
  const num = new Set(pairs.filter((pair) => pair.available).map((pair) => pair.scope)).size;
  const kind = plans.available === null ? "" : "available ";
  const routes = pairedRoutes(plan, pairs).length;
  const by = routes === 1 ? "the only route" : `one of the best ${routes} routes`;
  return `Of ${num} ${kind}instruments none is known to reach by ${by}.`;
}

/**
 * Return the available instruments after one of the library is marked or unmarked; null: all. The last marked one stays
 * marked, because no pair could be ranked without an instrument.
 */
export function withAvailable(
  library: readonly string[],
  available: readonly string[] | null,
  scope: string,
  on: boolean,
): string[] | null {
  const before = available ?? library;
  const names = library.filter((name) => (name === scope ? on : before.includes(name)));
  if (names.length === 0) return [...before];
  return names.length === library.length ? null : names;
}
