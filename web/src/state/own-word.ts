/** What was sent holds against the server's word for this long, so that a repeat does not stumble over older news. */
const OWN_WORD_MS = 600;

/** A value that is sent: the newest of what was sent and what the server says. */
export interface OwnWord<T> {
  now(): T;
  set(value: T): void;
}

export function ownWord<T>(server: () => T): OwnWord<T> {
  let own: { value: T; untilMs: number } | null = null;
  return {
    now: () => (own !== null && performance.now() < own.untilMs ? own.value : server()),
    set: (value) => {
      own = { value, untilMs: performance.now() + OWN_WORD_MS };
    },
  };
}
