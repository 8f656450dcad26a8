/** Questions to the table of views (`wire/views.ts`). No other file compares a view's name. */

import type { ViewName } from "../wire/messages";
import { CELLS, type CellName, LEAD_VIEW, PLANES, type PlaneName, VIEWS } from "../wire/views";

type Zoom = (typeof VIEWS)[ViewName]["zoom"];
type ViewsWith<Z extends Zoom> = { [V in ViewName]: (typeof VIEWS)[V]["zoom"] extends Z ? V : never }[ViewName];

/** Views that are zoomed and panned in their own plane. */
export type FlatView = ViewsWith<"slice" | "extent">;
/** Views whose camera goes round what they show. */
export type OrbitView = ViewsWith<"orbit">;
/** Places beside the airway view. */
export type SideCell = Exclude<CellName, typeof LEAD_VIEW>;
/** What each place of the window shows. */
export type ShownViews = Readonly<Record<CellName, ViewName>>;

export const VIEW_NAMES = Object.keys(VIEWS) as ViewName[];
export const SIDE_CELLS = (Object.keys(CELLS) as CellName[]).filter((cell): cell is SideCell => cell !== LEAD_VIEW);

export const isFlatView = (view: ViewName): view is FlatView =>
  VIEWS[view].zoom === "slice" || VIEWS[view].zoom === "extent";
export const isOrbitView = (view: ViewName): view is OrbitView => VIEWS[view].zoom === "orbit";
export const FLAT_VIEWS = VIEW_NAMES.filter(isFlatView);

export const viewsOf = (cell: CellName): readonly ViewName[] => CELLS[cell].views;

const firstOf = (cell: CellName): ViewName => CELLS[cell].views[0];
export const FIRST_SHOWN: ShownViews = Object.fromEntries(
  (Object.keys(CELLS) as CellName[]).map((cell) => [cell, firstOf(cell)]),
) as Record<CellName, ViewName>;

/** The view after the one that a place shows. */
export function nextIn(cell: CellName, shown: ShownViews): ViewName {
  const views = viewsOf(cell);
  return views[(views.indexOf(shown[cell]) + 1) % views.length] ?? firstOf(cell);
}

/** A view brought to its place. */
export const showing = (view: ViewName, shown: ShownViews): ShownViews => ({ ...shown, [VIEWS[view].cell]: view });

/** The view that is turned, or moved, like this. */
export function viewZoomedBy(zoom: Zoom): ViewName {
  const found = VIEW_NAMES.find((view) => VIEWS[view].zoom === zoom);
  if (found === undefined) throw new Error(`no view is moved by ${zoom}`);
  return found;
}

const PLANE_ORDER = Object.keys(PLANES) as PlaneName[];

/** The anatomical plane that stands across a patient axis. */
export function planeAcross(axis: 0 | 1 | 2): PlaneName {
  const found = PLANE_ORDER.find((plane) => PLANES[plane].axis === axis);
  if (found === undefined) throw new Error(`no plane stands across axis ${axis}`);
  return found;
}
