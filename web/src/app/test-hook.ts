/**
 * What browser tests may read: `window.__carina.state`, and on every picture's canvas `data-view`, `data-frame-id`,
 * `data-pose-id`, `data-full` and `data-shows`. Nothing in the product reads either.
 */

import type { AppState } from "../state/app-state";
import type { StateMessage } from "../wire/messages";
import type { Workstation } from "./workstation";

/** The server's last `state` message laid flat, beside what the client knows (`pose`, `route`, `tree`, `ui`, ...). */
export type TestState = AppState & Partial<StateMessage>;

declare global {
  interface Window {
    __carina?: { readonly state: TestState };
  }
}

export function exposeForTests(station: Workstation): void {
  window.__carina = {
    get state() {
      const state = station.store.get();
      return { ...state.session, ...state };
    },
  };
}
