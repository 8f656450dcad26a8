/**
 * Queries of the table of views (`wire/views.ts`). Other files use these queries instead of comparing names of views.
 */

import type { ViewName } from "../wire/messages";
import { CELLS, type CellName, LEAD_VIEW, PLANES, type PlaneName, VIEWS } from "../wire/views";

type Zoom = (typeof VIEWS)[ViewName]["zoom"];
type ViewsWith<Z extends Zoom> = { [V in ViewName]: (typeof VIEWS)[V]["zoom"] extends Z ? V : never }[ViewName];

/** Names of the views that zoom and pan in a plane. */
export type FlatView = ViewsWith<"slice" | "extent">;
/** Names of the views whose camera orbits the displayed object. */
export type OrbitView = ViewsWith<"orbit">;
/** Names of the window's cells beside the airway view. */
export type SideCell = Exclude<CellName, typeof LEAD_VIEW>;
/** The view that each cell of the window shows. */
export type ShownViews = Readonly<Record<CellName, ViewName>>;

/** Names of all views. */
export const VIEW_NAMES = Object.keys(VIEWS) as ViewName[];
/** Names of the cells beside the airway view, in order. */
export const SIDE_CELLS = (Object.keys(CELLS) as CellName[]).filter((cell): cell is SideCell => cell !== LEAD_VIEW);

/** Return whether a view zooms and pans in a plane. */
export const isFlatView = (view: ViewName): view is FlatView =>
  VIEWS[view].zoom === "slice" || VIEWS[view].zoom === "extent";
/** Return whether a view's camera orbits the displayed object. */
export const isOrbitView = (view: ViewName): view is OrbitView => VIEWS[view].zoom === "orbit";
/** The views that zoom and pan in a plane. */
export const FLAT_VIEWS = VIEW_NAMES.filter(isFlatView);

/** Return the views that a cell of the window can show. */
export const viewsOf = (cell: CellName): readonly ViewName[] => CELLS[cell].views;

/** Return the views that a cell of the window shows now: all of its views if a wide window has space for them. */
export const viewsShownIn = (cell: SideCell, shown: ShownViews, isWide: boolean): readonly ViewName[] =>
  isWide && CELLS[cell].all_when_wide ? viewsOf(cell) : [shown[cell]];

/** Return the views that a cell can show side by side in full view; empty for a cell without such a set. */
export const sideBySideOf = (cell: CellName): readonly ViewName[] => CELLS[cell].side_by_side;

const firstOf = (cell: CellName): ViewName => CELLS[cell].views[0];
/** The view that each cell of the window shows at first. */
export const FIRST_SHOWN: ShownViews = Object.fromEntries(
  (Object.keys(CELLS) as CellName[]).map((cell) => [cell, firstOf(cell)]),
) as Record<CellName, ViewName>;

/** Return the view that follows the current view of a cell, in cyclic order. */
export function nextIn(cell: CellName, shown: ShownViews): ViewName {
  const views = viewsOf(cell);
  return views[(views.indexOf(shown[cell]) + 1) % views.length] ?? firstOf(cell);
}

/** Return the shown views after one view was brought into its cell. */
export const showing = (view: ViewName, shown: ShownViews): ShownViews => ({ ...shown, [VIEWS[view].cell]: view });

/** Return the first view with a kind of zoom; throw an Error if there is none. */
export function viewZoomedBy(zoom: Zoom): ViewName {
  const found = VIEW_NAMES.find((view) => VIEWS[view].zoom === zoom);
  if (found === undefined) throw new Error(`no view has the zoom ${zoom}`);
  return found;
}

const PLANE_ORDER = Object.keys(PLANES) as PlaneName[];

/** Return the anatomical plane perpendicular to a patient axis. */
export function planeAcross(axis: 0 | 1 | 2): PlaneName {
  const found = PLANE_ORDER.find((plane) => PLANES[plane].axis === axis);
  if (found === undefined) throw new Error(`no plane is perpendicular to axis ${axis}`);
  return found;
}
