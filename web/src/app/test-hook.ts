/**
 * Data for browser tests: the object `window.__carina.state`, and the attributes `data-view`, `data-frame-id`, `data-
 * pose-id`, `data-full` and `data-shows` of every view's canvas. Only tests read these data.
 */

import type { AppState } from "../state/app-state";
import type { StateMessage } from "../wire/messages";
import type { Workstation } from "./workstation";

/**
 * State of the client (`pose`, `route`, `tree`, `ui`, ...) together with the fields of the server's latest `state`
 * message.
 */
export type TestState = AppState & Partial<StateMessage>;

declare global {
  interface Window {
    __carina?: { readonly state: TestState };
  }
}

/** Publish the state as `window.__carina.state` for browser tests. */
export function exposeForTests(station: Workstation): void {
  window.__carina = {
    get state() {
      const state = station.store.get();
      return { ...state.session, ...state };
    },
  };
}
