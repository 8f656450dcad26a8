/**
 * A value that a person is moving: shown at once, until the server has told what came of it.
 *
 * Without it, an answer to an older drag would throw the slider or the crosshair back for a moment. What another window
 * sets meanwhile is shown as soon as this window's own command is done: commands are done in one order for all.
 */
export interface Optimistic<T> {
  readonly value: T;
  /** Which of this connection's commands says it. */
  readonly number: number;
}

/** The number of a command that will be sent at the next refresh. */
export const NOT_SENT = Number.POSITIVE_INFINITY;

/** Values by name, as far as a person is moving them. */
export type Local<T> = { readonly [K in keyof T]?: Optimistic<T[K]> };

/** The value, unless so many commands have been handled that what the server tells is the outcome. */
export function underWay<T>(local: Optimistic<T> | null, handled: number): Optimistic<T> | null {
  return local !== null && local.number > handled ? local : null;
}

/** Those of several values for which that holds. */
export function allUnderWay<T extends object>(local: Local<T>, handled: number): Local<T> {
  const kept: { [K in keyof T]?: Optimistic<T[K]> } = {};
  for (const name of Object.keys(local) as (keyof T)[]) {
    const one = underWay(local[name] ?? null, handled);
    if (one !== null) kept[name] = one;
  }
  return kept;
}

/** What is shown: the server's values, and in their place those that a person is moving. */
export function shown<T extends object>(local: Local<T>, server: T): T {
  const value = { ...server };
  for (const name of Object.keys(local) as (keyof T)[]) {
    const one = local[name];
    if (one !== undefined) value[name] = one.value;
  }
  return value;
}
