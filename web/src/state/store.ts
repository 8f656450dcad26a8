/** Keeps one state and tells who listens. No framework: panels, pictures and tests read the same store. */

import { type AppEvent, type AppState, INITIAL_STATE, reduce } from "./app-state";

/** Runs a task once, soon: at the next screen refresh, say. */
export type Soon = (task: () => void) => void;

/** What comes without a person's hand, several times for each picture on the screen. */
const STREAMED: ReadonlySet<AppEvent["kind"]> = new Set([
  "server",
  "picture",
  "pace",
  "speed",
  "live_path",
  "preview",
] as const);

export class Store {
  #state: AppState;
  readonly #soon: Soon;
  readonly #listeners = new Set<() => void>();
  readonly #panels = new Set<() => void>();
  #panelsDue = false;

  /** `soon` says when panels hear of what streams in; of what a person does they hear at once. */
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

  /** Hears of every change at once. */
  subscribe = (listener: () => void): (() => void) => {
    this.#listeners.add(listener);
    return () => this.#listeners.delete(listener);
  };

  /**
   * For what is costly to show again: a pose and the pictures of it come within one refresh of the screen, and are told
   * of once.
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
