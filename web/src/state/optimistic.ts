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

/** Values by name, as far as a person is moving them. */
export type Local<T> = { readonly [K in keyof T]?: Optimistic<T[K]> };

/** What is shown of several values once the server has told them anew. */
export function allShown<T extends object>(local: Local<T>, server: T, nowMs: number): { value: T; local: Local<T> } {
  const value = { ...server };
  const kept: { [K in keyof T]?: Optimistic<T[K]> } = {};
  for (const name of Object.keys(local) as (keyof T)[]) {
    const one = shown(local[name] ?? null, server[name], isAlike, nowMs);
    value[name] = one.value;
    if (one.local !== null) kept[name] = one.local;
  }
  return { value, local: kept };
}

/** The same values, fields that are null or missing alike. */
export function isAlike(a: unknown, b: unknown): boolean {
  if (typeof a !== "object" || typeof b !== "object" || a === null || b === null) return (a ?? null) === (b ?? null);
  const names = new Set([...Object.keys(a), ...Object.keys(b)]);
  const [left, right] = [a as Record<string, unknown>, b as Record<string, unknown>];
  return [...names].every((name) => isAlike(left[name], right[name]));
}
