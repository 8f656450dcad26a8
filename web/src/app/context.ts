/** How panels read the state and reach the workstation. */

import { createContext, use, useSyncExternalStore } from "react";
import type { AppState } from "../state/app-state";
import type { Workstation } from "./workstation";

export const StationContext = createContext<Workstation | null>(null);

export function useStation(): Workstation {
  const station = use(StationContext);
  if (station === null) throw new Error("a panel needs a workstation around it");
  return station;
}

/** A part of the state; `select` must return the same object while its part has not changed. */
export function useApp<T>(select: (state: AppState) => T): T {
  const { store } = useStation();
  return useSyncExternalStore(store.subscribePanel, () => select(store.get()));
}
