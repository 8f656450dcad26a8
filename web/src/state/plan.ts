/** Texts about a plan, and the tip's position relative to its turns and route. */

import type {
  CArmPosition,
  Carm,
  Look,
  PlannedTurn,
  PlansMessage,
  RouteInfo,
  RouteOffer,
  ScopeVerdict,
  StationOnRoute,
  TargetPlan,
} from "../wire/messages";
import { withError } from "./branch-text";
import { fixed, mm } from "./format";
import { asVec3, sub, type Vec3 } from "./vec";

/** Return the plan of a target; null if there is none. */
export const planOf = (plans: PlansMessage | null, targetId: string | null): TargetPlan | null =>
  plans?.targets.find((target) => target.target_id === targetId) ?? null;

/** Return a fraction as a percentage. */
export const share = (part: number): string => `${fixed(100 * part)}\u202f%`;

/** Return the text of a value; a dash without a value. */
export const figure = (value: number | null | undefined, text: (value: number) => string): string =>
  value === null || value === undefined ? "\u2013" : text(value);

/** Distance between vessel and needle, mm, below which the needle crosses the vessel. */
const CROSSED_VESSEL_MM = 0.05;

/** Return the distance of the needle from the nearest vessel as the text of a table's cell. */
export const vesselCell = (distanceMm: number | null): string => {
  if (distanceMm === null) return "none seen";
  return distanceMm < CROSSED_VESSEL_MM ? "on the way" : mm(distanceMm);
};

/** Rows of the table that compares routes, with the function that returns each row's text. */
export const ROUTE_ROWS: readonly { title: string; words: string; of: (route: RouteOffer) => string }[] = [
  { title: "Airway", words: "The airway in which the scope is parked", of: (route) => route.branch_name },
  {
    title: "Outlook",
    words: "Whether the planned scope and tool reach the target by this route, by width, bend and pointing",
    of: (route) => route.outlook,
  },
  {
    title: "Past carina",
    words: "Distance from the ridge of the main carina to the place where the scope stops",
    of: (route) => (route.from_carina_mm === null ? "\u2013" : mm(route.from_carina_mm, 0)),
  },
  {
    title: "Narrowest",
    words:
      "Narrowest diameter of the whole way, with half of its 90\u202f% interval; by ball: a part of the way could not be measured",
    of: (route) =>
      `${withError(route.narrowest_mm, route.narrowest_error_mm) ?? ""}${route.narrowest_by === "ball" ? " (by ball)" : ""}`,
  },
  {
    title: "Scope",
    words: "Whether the planned scope fits; may fit: only if the errors are in its favour",
    of: (route) => route.fit,
  },
  {
    title: "Fork angle*",
    words: "Bifurcation angle: between the axes of the tip's airway and of its parent",
    of: ({ predictors }) => figure(predictors?.bifurcation_deg, (deg) => `${fixed(deg)}\u00b0`),
  },
  {
    title: "Narrowest, end*",
    words: "Narrowest diameter of the last 20\u00a0mm of the way, with half of its 90\u202f% interval",
    of: ({ predictors }) =>
      figure(predictors?.least_mm, (least) => withError(least, predictors?.least_error_mm ?? 0) ?? ""),
  },
  {
    title: "Curvature, end*",
    words: "Mean curvature of the last 20\u00a0mm of the way, 1/mm",
    of: ({ predictors }) => figure(predictors?.curvature_per_mm, (value) => `${value.toFixed(3)}/mm`),
  },
  {
    title: "Needle",
    words: "From the scope's tip to the target's edge",
    of: (route) => mm(route.leg.to_target_mm, 0),
  },
  { title: "Angle", words: "Between needle and airway", of: (route) => `${fixed(route.leg.angle_deg)}\u00b0` },
  { title: "In target", words: "Needle path inside the target", of: (route) => mm(route.leg.in_target_mm, 0) },
  {
    title: "Vessel",
    words: "From the needle to the nearest visible vessel",
    of: (route) => vesselCell(route.leg.vessel_mm),
  },
  {
    title: "Hits",
    words: "Share of needle passes that hit after the simulated drive; none without a drive",
    of: (r) => (r.leg.hit_share === null ? "\u2013" : share(r.leg.hit_share)),
  },
  {
    title: "If moved",
    words: "The same if the target has moved since the CT",
    of: (route) => (route.leg.hit_share_moved === null ? "\u2013" : share(route.leg.hit_share_moved)),
  },
];

/** Return the verdicts in display order: first the instruments that reach the target, then those that may reach it. */
export function verdictsInOrder(verdicts: readonly ScopeVerdict[]): ScopeVerdict[] {
  return [...verdicts].sort((a, b) => rank(a) - rank(b));
}

const ORDER = ["reaches", "may reach", "cannot say", "does not reach"];
const rank = ({ outcome }: ScopeVerdict): number => (ORDER.indexOf(outcome) + ORDER.length + 1) % (ORDER.length + 1);

/** Return the text of a turn for the selected operator position. */
export const turnText = (turn: PlannedTurn, operator: Look["operator"]): string =>
  operator === "head" ? turn.head : turn.facing;

/** Return the text of a lymph node station of a route for the selected operator position. */
export const stationText = (station: StationOnRoute, operator: Look["operator"]): string =>
  operator === "head" ? station.head : station.facing;

/** Distance of the crosshair from the landmark of a station, mm, up to which the slices show the station. */
const SHOWN_MM = 0.05;

/** Return whether the slices show the landmark of a station of a route, where the user has moved the crosshair. */
export const isStationShown = (station: StationOnRoute, crosshair: Vec3 | null): boolean =>
  crosshair !== null && Math.hypot(...sub(asVec3(station.point_lps), crosshair)) <= SHOWN_MM;

/** Return the stations of a plan whose landmark the slices show; stations 7 and 10 can have the same landmark. */
export const stationsShown = (plan: TargetPlan | null, crosshair: Vec3 | null): StationOnRoute[] =>
  plan?.stations.filter((station) => isStationShown(station, crosshair)) ?? [];

/** Return whether the C-arm of the X-ray view is at a position, up to the rounding of its text. */
export const isCArmAt = (carm: Carm, position: CArmPosition): boolean =>
  Math.abs(carm.primary_deg - position.primary_deg) < 0.5 &&
  Math.abs(carm.secondary_deg - position.secondary_deg) < 0.5;

/**
 * Distance of the tip from the viewpoint of a turn, mm, up to which the tip counts as being at the viewpoint; turning
 * the view moves the tip slightly.
 */
const AT_VIEWPOINT_MM = 0.3;

/** Return the list index of the turn at whose viewpoint the tip is; null if the tip is not at a viewpoint. */
export function turnBefore(turns: readonly PlannedTurn[], tip: Vec3 | null): number | null {
  if (tip === null) return null;
  const at = turns.findIndex(
    ({ seen_from_lps: from }) => from !== null && Math.hypot(...sub(asVec3(from), tip)) <= AT_VIEWPOINT_MM,
  );
  return at < 0 ? null : at;
}

/**
 * Return the position along the route, mm, nearest to a freely moved tip; null if the tip is outside the route's
 * airways.
 */
export function distanceToRouteMm(route: RouteInfo, tip: Vec3): number | null {
  let best: { mm: number; away: number; radius: number } | null = null;
  route.points_lps.forEach((point, n) => {
    const away = Math.hypot(...sub(asVec3(point), tip));
    if (best === null || away < best.away) {
      best = { mm: route.cumulative_mm[n] ?? 0, away, radius: route.radius_mm[n] ?? 0 };
    }
  });
  const found = best as { mm: number; away: number; radius: number } | null;
  return found !== null && found.away <= Math.max(found.radius, 1) ? found.mm : null;
}

/** Return how many of the other instruments reach a target, and how many may reach the target, as text. */
export function othersText(others: readonly ScopeVerdict[], standing: PlansMessage["verdicts_standing"]): string {
  const count = (outcome: string): number => others.filter((verdict) => verdict.outcome === outcome).length;
  const text = `${others.length} other instruments: ${count("reaches")} reach it, ${count("may reach")} may reach it`;
  return standing === "making" ? `${text} so far` : text;
}
