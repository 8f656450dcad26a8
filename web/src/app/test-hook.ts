/**
 * Data for browser tests: `window.__carina.state`, and on every view's canvas `data-view`, `data-frame-id`, `data-pose-
 * id`, `data-full` and `data-shows`. The product itself reads none of it.
 */

import type { AppState } from "../state/app-state";
import type { StateMessage } from "../wire/messages";
import type { Workstation } from "./workstation";

/**
 * The fields of the server's latest `state` message together with the client's state (`pose`, `route`, `tree`, `ui`,
 * ...).
 */
export type TestState = AppState & Partial<StateMessage>;

declare global {
  interface Window {
    __carina?: { readonly state: TestState };
  }
}

/** Publish the state for browser tests. */
export function exposeForTests(station: Workstation): void {
  window.__carina = {
    get state() {
      const state = station.store.get();
      return { ...state.session, ...state };
    },
  };
}
