/**
 * Store of the state with listeners. It does not depend on a framework: panels, pictures and tests read the same store.
 */

import { type AppEvent, type AppState, INITIAL_STATE, reduce } from "./app-state";

/** A scheduler that runs a task once at a later time, such as the next display refresh. */
export type Soon = (task: () => void) => void;

/** Kinds of events that arrive several times per picture without an action of the user. */
const STREAMED: ReadonlySet<AppEvent["kind"]> = new Set([
  "server",
  "picture",
  "pace",
  "speed",
  "live_path",
  "preview",
] as const);

/** Store of the page's state, with listeners. */
export class Store {
  #state: AppState;
  readonly #soon: Soon;
  readonly #listeners = new Set<() => void>();
  readonly #panels = new Set<() => void>();
  #panelsDue = false;

  /**
   * `soon` schedules the notification of panels after streamed events. After an action of the user the panels are
   * notified immediately.
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
   * Add a listener for components that are slow to render; return a function that removes it. After streamed events the
   * listener is called once per display refresh, for example for a pose and its pictures.
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
