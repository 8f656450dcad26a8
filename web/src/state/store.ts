/**
 * Store of the state with listeners. It does not depend on a framework: panels, pictures and tests read the same store.
 */

import { type AppEvent, type AppState, INITIAL_STATE, reduce } from "./app-state";

/** Run a task once, at a later time such as the next display refresh. */
export type Soon = (task: () => void) => void;

/** Events that the server sends several times per picture, without an action of the user. */
const STREAMED: ReadonlySet<AppEvent["kind"]> = new Set([
  "server",
  "picture",
  "pace",
  "speed",
  "live_path",
  "preview",
] as const);

/** Store of the state. */
export class Store {
  #state: AppState;
  readonly #soon: Soon;
  readonly #listeners = new Set<() => void>();
  readonly #panels = new Set<() => void>();
  #panelsDue = false;

  /**
   * `soon` schedules the notification of panels after streamed events; panels are notified of the user's actions
   * immediately.
   */
  constructor(initial: AppState = INITIAL_STATE, soon: Soon = (task) => task()) {
    this.#state = initial;
    this.#soon = soon;
  }

  get = (): AppState => this.#state;

  dispatch = (event: AppEvent): void => {
    const next = reduce(this.#state, event);
    if (next === this.#state) return;
    this.#state = next;
    for (const listener of this.#listeners) listener();
    if (!STREAMED.has(event.kind)) this.#tellPanels();
    else if (!this.#panelsDue) {
      this.#panelsDue = true;
      this.#soon(() => {
        if (this.#panelsDue) this.#tellPanels();
      });
    }
  };

  /** Add a listener that is called immediately after every change; return a function that removes it. */
  subscribe = (listener: () => void): (() => void) => {
    this.#listeners.add(listener);
    return () => this.#listeners.delete(listener);
  };

  /**
   * Add a listener for components that are slow to render; return a function that removes it. A pose and its pictures
   * arrive within one display refresh and cause one call.
   */
  subscribePanel = (listener: () => void): (() => void) => {
    this.#panels.add(listener);
    return () => this.#panels.delete(listener);
  };

  #tellPanels(): void {
    this.#panelsDue = false;
    for (const listener of this.#panels) listener();
  }
}
