/** Scheduling of a task at the next display refresh, or after a short time in a hidden window. */

/** Maximum delay of a task, ms. A hidden window has no display refresh, but its messages must still be sent. */
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
