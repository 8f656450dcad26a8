/** Reasons why the picture of all forks of a route cannot be saved, and why captions of a flight name no turns. */

import type { AppState } from "./app-state";

/**
 * Return whether the path of the route was searched in the airways. The turns come from the airway tree, so they do not
 * describe a path that was searched with another cost function.
 */
export function isSearchedInAirways({ route, session }: Pick<AppState, "route" | "session">): boolean {
  // A planned route with a needle follows the airways.
  if (route === null || route.target_id === null || route.needle !== null) return true;
  const target = session?.targets.find(({ target_id }) => target_id === route.target_id);
  return target === undefined || target.cost === "lumen";
}

/** Return the reason why the forks of the route cannot be saved now, as text for the user; null if they can. */
export function forksProblem(state: AppState): string | null {
  const { route, tree, ui } = state;
  if (route === null) return "There is no route yet. Choose a branch, or mark a target.";
  if (!isSearchedInAirways(state)) {
    return "This path was not searched in the airways. Forks are shown for routes in the lumen.";
  }
  if (tree === null) return "The airways have not been segmented yet.";
  if (route.forks_mm.length === 0) return "This route passes no fork.";
  return ui.makingForks ? "The forks are being rendered. Wait, or cancel." : null;
}
