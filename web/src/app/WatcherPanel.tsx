/** In the place of the step's panel, in a window that only watches. */

export function WatcherPanel() {
  return (
    <section className="step-panel" aria-label="Watching" data-testid="watcher-panel">
      <h2>Watching</h2>
      <div className="step-body">
        <p>The pictures follow the person at the workstation. You can change nothing in the case.</p>
        <p className="quiet">Scroll, zoom and drag in the slices as you like: nobody else sees it.</p>
      </div>
    </section>
  );
}
