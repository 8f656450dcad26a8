/** Scheduling at the next display refresh, or after a short time in a hidden window. */

/** Longest delay, ms: a hidden window has no display refresh, but messages must still be sent. */
const HIDDEN_MS = 250;

/** Run a task once at the next display refresh. */
export function atNextRefresh(task: () => void): void {
  const late = setTimeout(() => {
    cancelAnimationFrame(refresh);
    task();
  }, HIDDEN_MS);
  const refresh = requestAnimationFrame(() => {
    clearTimeout(late);
    task();
  });
}
