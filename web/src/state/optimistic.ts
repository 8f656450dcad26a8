/**
 * A value that the user has changed: it is shown at once, until the server has sent the result of the command.
 *
 * This prevents an answer to an older drag from moving the slider or crosshair back for a moment. A change by another
 * window is shown when this window's command is done, because the server executes all commands in one order.
 */
export interface Optimistic<T> {
  readonly value: T;
  /** Number, on this connection, of the command that sets the value. */
  readonly number: number;
}

/** Number of a command that waits to be sent at the next display refresh. */
export const NOT_SENT = Number.POSITIVE_INFINITY;

/** Values that the user has changed, by name. */
export type Local<T> = { readonly [K in keyof T]?: Optimistic<T[K]> };

/** Return the user's value; null once the server has executed its command. */
export function underWay<T>(local: Optimistic<T> | null, handled: number): Optimistic<T> | null {
  return local !== null && local.number > handled ? local : null;
}

/** Return the values whose commands the server has not executed yet. */
export function allUnderWay<T extends object>(local: Local<T>, handled: number): Local<T> {
  const pending: { [K in keyof T]?: Optimistic<T[K]> } = {};
  for (const name of Object.keys(local) as (keyof T)[]) {
    const one = underWay(local[name] ?? null, handled);
    if (one !== null) pending[name] = one;
  }
  return pending;
}

/** Return the values to show: the server's values, replaced by those that the user has changed. */
export function shown<T extends object>(local: Local<T>, server: T): T {
  const value = { ...server };
  for (const name of Object.keys(local) as (keyof T)[]) {
    const one = local[name];
    if (one !== undefined) value[name] = one.value;
  }
  return value;
}
