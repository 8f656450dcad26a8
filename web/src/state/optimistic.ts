/**
 * A value that a person is moving: shown at once, until the server says the same or has had its chance.
 *
 * Without it, an answer to an older drag would throw the slider or the crosshair back for a moment.
 */
export interface Optimistic<T> {
  readonly value: T;
  readonly atMs: number;
}

/** After this long without an answer the server's word counts again (it may have refused). */
export const OPTIMISTIC_MS = 1200;

export function shown<T>(
  local: Optimistic<T> | null,
  server: T,
  same: (a: T, b: T) => boolean,
  nowMs: number,
): { value: T; local: Optimistic<T> | null } {
  if (local === null) return { value: server, local: null };
  if (same(local.value, server) || nowMs - local.atMs > OPTIMISTIC_MS) return { value: server, local: null };
  return { value: local.value, local };
}
