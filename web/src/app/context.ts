/** React hooks that give a component the state and the workstation. */

import { createContext, use, useSyncExternalStore } from "react";
import type { AppState } from "../state/app-state";
import type { Workstation } from "./workstation";

/** React context that holds the workstation. */
export const StationContext = createContext<Workstation | null>(null);

/** Return the workstation; throw an Error in a component outside the workstation's context. */
export function useStation(): Workstation {
  const station = use(StationContext);
  if (station === null) throw new Error("a panel must be inside a workstation");
  return station;
}

/**
 * Return a part of the state, and render the component again when the part changes. `select` must return the same
 * object while its part has not changed.
 */
export function useApp<T>(select: (state: AppState) => T): T {
  const { store } = useStation();
  return useSyncExternalStore(store.subscribePanel, () => select(store.get()));
}
