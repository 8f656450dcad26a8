/** Panel that replaces the step's panel in a window that only watches. */

import { attemptText } from "../state/course";
import { sentence } from "../state/format";
import { clock } from "../state/playing";
import { attemptOf, outcomeText, progressText } from "../state/training";
import type { ClassLearner } from "../wire/messages";
import { useApp } from "./context";
import { AttemptClock } from "./steps/TrainStep";

/** Render the text that replaces the panel of the step in a window that only watches, and the training that runs. */
export function WatcherPanel() {
  return (
    <section className="step-panel" aria-label="You are watching" data-testid="watcher-panel">
      <h2>You are watching</h2>
      {/* biome-ignore lint/a11y/noNoninteractiveTabindex: the keyboard scrolls the scores of a class */}
      <section className="step-body" aria-label="Training that you watch" tabIndex={0}>
        <p>The views follow the person at the workstation. You cannot change anything in the case.</p>
        <p className="quiet">You can scroll, zoom and pan the slices freely: this changes only your own view.</p>
        <WatchedTraining />
      </section>
    </section>
  );
}

/**
 * Render the running attempt and the scores of this case, and all learners if the person at the workstation shares them
 * with a teacher.
 */
function WatchedTraining() {
  const attempt = useApp(attemptOf);
  const scores = useApp((state) => state.training?.scores ?? null) ?? [];
  const classroom = useApp((state) => state.training?.classroom ?? null) ?? [];
  if (attempt === null && scores.length === 0 && classroom.length === 0) return null;
  return (
    <div data-testid="watched-training">
      <h3>Training</h3>
      {attempt === null ? null : (
        <>
          <p>
            <strong>{attempt.task.title}</strong>
            {attempt.running.learner === null ? null : <span> ({attempt.running.learner})</span>}
          </p>
          <AttemptClock attempt={attempt} />
          <p>{attempt.running.paused ? "Paused" : progressText(attempt)}</p>
          <p className={attempt.running.is_warning ? "warning-text" : "quiet"}>
            {attempt.running.message === null ? "" : sentence(attempt.running.message)}
          </p>
        </>
      )}
      <Classroom learners={classroom} />
      {scores.length === 0 ? null : <h3>Scores of this case</h3>}
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

/** Render all learners with their latest attempts. */
function Classroom({ learners }: { learners: readonly ClassLearner[] }) {
  if (learners.length === 0) return null;
  return (
    <div data-testid="classroom">
      <h3>Learners</h3>
      <ul className="key-list" aria-label="Learners">
        {learners.map(({ learner: { name, verdict }, attempts, running }) => (
          <li key={name} className="key task" data-testid="class-learner">
            <strong>{name}</strong>
            {running === null ? null : <p>Flying now: {running}</p>}
            {attempts.length === 0 ? <p className="quiet">No attempt yet</p> : null}
            {attempts.map((one) => (
              <p key={one.number} className="quiet numbers">
                {one.number}. {one.title}: {attemptText(one)}
                {one.counts || !one.is_inspection ? "" : ", does not count"}
              </p>
            ))}
            <p className="quiet">{sentence(verdict)}</p>
          </li>
        ))}
      </ul>
    </div>
  );
}
