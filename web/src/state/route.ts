/** The current route, parametrised by the distance from its root in mm. */

import type { RouteInfo, RouteSpan } from "../wire/messages";
import { mm } from "./format";
import { asVec3, lerp, sub, unit, type Vec3 } from "./vec";

/**
 * Distance, mm, below which two places count as the same fork, so that a rounded pose at a fork does not count as
 * before the fork.
 */
export const FORK_TOLERANCE_MM = 0.5;

/**
 * Return the position along the route, mm, at which the automatic flight stops: the viewpoint before the next fork,
 * else the end of the route.
 */
export function nextStopMm(route: Pick<RouteInfo, "lookouts_mm" | "length_mm">, pathMm: number): number {
  return route.lookouts_mm.find((at) => at > pathMm + FORK_TOLERANCE_MM) ?? route.length_mm;
}

/** Return a position clamped to the route, mm. */
export function clampToRoute(route: Pick<RouteInfo, "length_mm">, pathMm: number): number {
  return Math.min(Math.max(pathMm, 0), route.length_mm);
}

/** Properties of a route that define its distances from the origin. */
export type WithOrigin = Pick<RouteInfo, "origin" | "lumen_known" | "cumulative_mm" | "centreline_mm">;

/** Return whether the distances along a route are measured from the main carina. */
export const isFromCarina = ({ origin }: WithOrigin): boolean => origin.kind === "ridge" || origin.kind === "axes";

/** Distance, mm, below which a place is described as at the origin. */
const AT_ORIGIN_MM = 0.5;

/** Return the value of one list at a value of a parallel, ascending list, by linear interpolation. */
function interpolated(at: number, ascending: readonly number[], values: readonly number[]): number {
  if (ascending.length < 2 || values.length !== ascending.length) return at;
  const index = Math.min(indexAt(ascending, at), ascending.length - 2);
  const [from = 0, to = 0] = [ascending[index], ascending[index + 1]];
  const [a = 0, b = 0] = [values[index], values[index + 1]];
  return to > from ? a + ((b - a) * (at - from)) / (to - from) : a;
}

/**
 * Return the distance of a position along the route from the origin, mm, as plans state it: along the centrelines,
 * which are longer than the smoothed route; below 0 before the origin. A path that was not searched in the airways is
 * measured along the path itself.
 */
export const pastMm = (route: WithOrigin, pathMm: number): number =>
  interpolated(pathMm, route.cumulative_mm, route.centreline_mm) - route.origin.along_mm;

/** Return the position along the route, mm, at a distance from the origin; the inverse of {@link pastMm}. */
export const pathAtMm = (route: WithOrigin, past: number): number =>
  interpolated(past + route.origin.along_mm, route.centreline_mm, route.cumulative_mm);

/** Return the origin of the distances along a route as text, such as *the main carina*. */
export function originText(route: WithOrigin): string {
  if (isFromCarina(route)) return "the main carina";
  return route.origin.kind === "root" && route.lumen_known ? "the start of the airway tree" : "the start of the route";
}

/** Return a position along a route as text, with the same origin as in the plan: *42 mm past the main carina*. */
export function placeText(route: WithOrigin, pathMm: number): string {
  const past = pastMm(route, pathMm);
  return isFromCarina(route) ? carinaText(past) : `${mm(past, 0)} from ${originText(route)}`;
}

/** Return a distance from the main carina as text: *42 mm past the main carina*. */
export function carinaText(past: number): string {
  if (Math.abs(past) < AT_ORIGIN_MM) return "at the main carina";
  return `${mm(Math.abs(past), 0)} ${past > 0 ? "past" : "above"} the main carina`;
}

/**
 * Return the end of a path through the airways as text, with the same origin as in plans. A path that does not pass the
 * main carina is measured from the start of the airway tree.
 */
export function endText(path: { readonly length_mm: number; readonly from_carina_mm: number | null }): string {
  return path.from_carina_mm === null
    ? `${mm(path.length_mm, 0)} from the start of the airway tree`
    : carinaText(path.from_carina_mm);
}

/** Return the word for the side of the origin on which a position is, for a short reading beside the distance. */
export function sideText(route: WithOrigin, pathMm: number): string {
  if (!isFromCarina(route)) return "from start";
  return pastMm(route, pathMm) < 0 ? "above carina" : "past carina";
}

/** Return the labelled distances of the ruler from the origin, mm: multiples of a step, on both sides of the origin. */
export function scaleMm(route: WithOrigin, lengthMm: number, stepMm: number): number[] {
  // The last label must not be under the flag at the end.
  return multiplesBetween(pastMm(route, 0), pastMm(route, lengthMm) - 0.35 * stepMm, stepMm);
}

/** Return the multiples of a step from a first to a last value, both included. */
export function multiplesBetween(firstMm: number, lastMm: number, stepMm: number): number[] {
  const first = Math.ceil(firstMm / stepMm - 1e-6);
  const last = Math.floor(lastMm / stepMm + 1e-6);
  return Array.from({ length: Math.max(last - first + 1, 0) }, (_, n) => (first + n) * stepMm);
}

/** Return the index of the last route point at or before a position. */
function indexAt(cumulativeMm: readonly number[], pathMm: number): number {
  let low = 0;
  let high = cumulativeMm.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if ((cumulativeMm[middle] ?? 0) <= pathMm) low = middle;
    else high = middle - 1;
  }
  return low;
}

/** Return the interpolated route point at a position; null for a route without points. */
export function pointAt(route: Pick<RouteInfo, "points_lps" | "cumulative_mm">, pathMm: number): Vec3 | null {
  const index = indexAt(route.cumulative_mm, pathMm);
  const a = route.points_lps[index];
  if (a === undefined) return null;
  const b = route.points_lps[index + 1];
  const from = route.cumulative_mm[index] ?? 0;
  const to = route.cumulative_mm[index + 1] ?? from;
  if (b === undefined || to <= from) return asVec3(a);
  const t = Math.min(Math.max((pathMm - from) / (to - from), 0), 1);
  return lerp(asVec3(a), asVec3(b), t);
}

/** Return the interpolated lumen radius at a position along the route, mm; 0 if the route has no radii. */
export function radiusAt(route: Pick<RouteInfo, "radius_mm" | "cumulative_mm">, pathMm: number): number {
  const index = indexAt(route.cumulative_mm, pathMm);
  const a = route.radius_mm[index] ?? 0;
  const b = route.radius_mm[index + 1] ?? a;
  const from = route.cumulative_mm[index] ?? 0;
  const to = route.cumulative_mm[index + 1] ?? from;
  return to > from ? a + (b - a) * Math.min(Math.max((pathMm - from) / (to - from), 0), 1) : a;
}

/** Return the route points between two positions, both ends included. */
export function pointsBetween(
  route: Pick<RouteInfo, "points_lps" | "cumulative_mm">,
  fromMm: number,
  toMm: number,
): Vec3[] {
  const first = pointAt(route, fromMm);
  const last = pointAt(route, toMm);
  if (first === null || last === null) return [];
  const inner: Vec3[] = [];
  for (let index = indexAt(route.cumulative_mm, fromMm) + 1; index < route.points_lps.length; index += 1) {
    if ((route.cumulative_mm[index] ?? 0) >= toMm) break;
    const point = route.points_lps[index];
    if (point !== undefined) inner.push(asVec3(point));
  }
  return [first, ...inner, last];
}

/** Return the unit direction of the route at a position, LPS; null for a route without points. */
export function directionAt(route: Pick<RouteInfo, "points_lps" | "cumulative_mm">, pathMm: number): Vec3 | null {
  const a = pointAt(route, pathMm - 0.5);
  const b = pointAt(route, pathMm + 0.5);
  return a === null || b === null ? null : unit(sub(b, a));
}

/**
 * Return the branch of the route at a position; the last branch for a position outside all branches, null for a route
 * without branches.
 */
export function spanAt(route: Pick<RouteInfo, "spans">, pathMm: number): RouteSpan | null {
  return route.spans.find((span) => pathMm >= span.from_mm && pathMm < span.to_mm) ?? route.spans.at(-1) ?? null;
}

/** Return the position along the route, mm, of the route point nearest to a patient point. */
export function nearestMm(route: Pick<RouteInfo, "points_lps" | "cumulative_mm">, lps: Vec3): number {
  let best = Number.POSITIVE_INFINITY;
  let at = 0;
  route.points_lps.forEach((point, index) => {
    const d = Math.hypot(point[0] - lps[0], point[1] - lps[1], point[2] - lps[2]);
    if (d < best) {
      best = d;
      at = route.cumulative_mm[index] ?? 0;
    }
  });
  return at;
}
