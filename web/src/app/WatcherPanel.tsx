/** Panel that replaces the step's panel in a window that only watches. */

/** Render the text that replaces the panel of the step in a window that only watches. */
export function WatcherPanel() {
  return (
    <section className="step-panel" aria-label="You are watching" data-testid="watcher-panel">
      <h2>You are watching</h2>
      <div className="step-body">
        <p>The views follow the person at the workstation. You cannot change anything in the case.</p>
        <p className="quiet">You can scroll, zoom and pan the slices freely: this changes only your own view.</p>
      </div>
    </section>
  );
}
