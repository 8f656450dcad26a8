/** The next refresh of the screen, or soon after where there is none. */

/** Where a window is hidden the screen is not refreshed; what is told must not wait for that. */
const HIDDEN_MS = 250;

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
