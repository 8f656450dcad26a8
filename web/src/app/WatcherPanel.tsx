/** Panel that replaces the step's panel in a window that only watches. */

import { sentence } from "../state/format";
import { clock } from "../state/playing";
import { attemptOf, outcomeText, progressText } from "../state/training";
import { useApp } from "./context";
import { AttemptClock } from "./steps/TrainStep";

/** Render the text that replaces the panel of the step in a window that only watches, and the training that runs. */
export function WatcherPanel() {
  return (
    <section className="step-panel" aria-label="You are watching" data-testid="watcher-panel">
      <h2>You are watching</h2>
      <div className="step-body">
        <p>The views follow the person at the workstation. You cannot change anything in the case.</p>
        <p className="quiet">You can scroll, zoom and pan the slices freely: this changes only your own view.</p>
        <WatchedTraining />
      </div>
    </section>
  );
}

/** Render the running attempt and the scores of this case, for a teacher; pseudonyms are not sent to watchers. */
function WatchedTraining() {
  const attempt = useApp(attemptOf);
  const scores = useApp((state) => state.training?.scores ?? null) ?? [];
  if (attempt === null && scores.length === 0) return null;
  return (
    <div data-testid="watched-training">
      <h3>Training</h3>
      {attempt === null ? null : (
        <>
          <p>
            <strong>{attempt.task.title}</strong>
          </p>
          <AttemptClock attempt={attempt} />
          <p>{attempt.running.paused ? "Paused" : progressText(attempt)}</p>
          <p className={attempt.running.is_warning ? "warning-text" : "quiet"}>
            {attempt.running.message === null ? "" : sentence(attempt.running.message)}
          </p>
        </>
      )}
      <ul className="key-list" aria-label="Scores">
        {scores.map((score) => (
          <li key={score.flight} className="key task">
            <strong>{score.task_title}</strong>
            <p className="quiet numbers">
              {outcomeText(score)}, {clock(score.published.time_s)}
              {score.is_inspection ? `, ${score.published.num_progressions} in order` : ""}
              {score.doubts.length === 0 ? "" : ", does not count"}
            </p>
          </li>
        ))}
      </ul>
    </div>
  );
}
