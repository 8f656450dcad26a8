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
  forMs = OPTIMISTIC_MS,
): { value: T; local: Optimistic<T> | null } {
  if (local === null) return { value: server, local: null };
  if (same(local.value, server) || nowMs - local.atMs > forMs) return { value: server, local: null };
  return { value: local.value, local };
}

/** What was sent holds against the server's word for this long where nothing tells which of both is newer. */
export const HELD_MS = 600;

/** A value that is sent from where the state is only read: the newest of what was sent and what the server says. */
export interface Held<T> {
  now(): T;
  set(value: T): void;
}

const never = () => false;

/** So that a repeat does not stumble over older news: the person's word holds, even against an answer, for {@link HELD_MS}. */
export function held<T>(server: () => T, nowMs: () => number): Held<T> {
  let local: Optimistic<T> | null = null;
  return {
    now: () => {
      const word = shown(local, server(), never, nowMs(), HELD_MS);
      local = word.local;
      return word.value;
    },
    set: (value) => {
      local = { value, atMs: nowMs() };
    },
  };
}
