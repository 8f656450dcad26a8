/** Keeps one state and tells who listens. No framework: panels, pictures and tests read the same store. */

import { type AppEvent, type AppState, INITIAL_STATE, reduce } from "./app-state";

export class Store {
  #state: AppState;
  readonly #listeners = new Set<() => void>();

  constructor(initial: AppState = INITIAL_STATE) {
    this.#state = initial;
  }

  get = (): AppState => this.#state;

  dispatch = (event: AppEvent): void => {
    const next = reduce(this.#state, event);
    if (next === this.#state) return;
    this.#state = next;
    for (const listener of this.#listeners) listener();
  };

  subscribe = (listener: () => void): (() => void) => {
    this.#listeners.add(listener);
    return () => this.#listeners.delete(listener);
  };
}
