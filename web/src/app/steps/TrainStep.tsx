import { useEffect, useState } from "react";
import { keyOf } from "../../input/keymap";
import { fixed, sentence } from "../../state/format";
import { clock } from "../../state/playing";
import {
  type Attempt,
  answerText,
  attemptOf,
  isAtQuestion,
  outcomeText,
  progressText,
  questionText,
  quizOf,
  timeText,
} from "../../state/training";
import type { FlightScore, QuizInfo, TaskInfo } from "../../wire/messages";
import { BreathingControls, useBreathingOfStep } from "../BreathingControls";
import { CoursePanel } from "../CoursePanel";
import { useApp, useStation } from "../context";
import { Act } from "../controls";
import { Icon } from "../icons";
import { ScopeSelect } from "../ScopeSelect";
import { VoiceFeedback, VoiceSwitch } from "../VoiceFeedback";

/** Render the panel of the Train step: the tasks and the scores, or the running attempt. */
export function TrainStep() {
  const training = useApp((state) => state.training);
  const attempt = useApp(attemptOf);
  const quiz = useApp(quizOf);
  const breathingSwitched = useBreathingOfStep();
  if (attempt !== null) return <RunningAttempt attempt={attempt} />;
  if (quiz !== null) return <RunningQuiz quiz={quiz} />;
  if (training === null) return null;
  return (
    <>
      <p>
        Choose a task to fly with a simulated bronchoscope. The flight is recorded in this case and scored by published
        measures.
      </p>
      <CoursePanel course={training.course} />
      <ScopeSelect />
      <BreathingControls switched={breathingSwitched} />
      <VoiceSwitch />
      <ul className="key-list" aria-label="Tasks" data-testid="tasks">
        {training.tasks.map((task) => (
          <TaskRow key={task.name} task={task} />
        ))}
      </ul>
      <OwnTasks folder={training.task_folder} problems={training.task_problems} />
      <Quizzes />
      <Scores scores={training.scores} verdict={training.verdict} />
    </>
  );
}

function TaskRow({ task }: { task: TaskInfo }) {
  const station = useStation();
  const limit = task.time_limit_s === null ? "no time limit" : `${fixed(task.time_limit_s / 60)} min`;
  return (
    <li className="key task" data-testid={`task-${task.name}`}>
      <div className="key-head">
        <span className="flight-words">
          <strong>{task.title}</strong>
          <span className="quiet numbers">
            {task.is_own ? "own task, " : ""}
            {task.level}, {limit}
            {task.names_shown ? "" : ", names hidden"}
            {task.tree_shown ? ", with the tree" : ""}
          </span>
        </span>
        <Act
          kind="primary"
          icon="play"
          words={`Start: ${task.title}`}
          disabled={task.problem !== null}
          testId={`start-${task.name}`}
          onPress={() => station.startTask(task.name)}
        />
      </div>
      {task.problem === null ? null : <p className="warning-text">{sentence(task.problem)}</p>}
    </li>
  );
}

/** Render the folder of the teacher's own tasks, and the files that cannot be used. */
function OwnTasks({ folder, problems }: { folder: string | null; problems: readonly string[] }) {
  const station = useStation();
  if (folder === null) return null;
  return (
    <div className="own-tasks" data-testid="own-tasks">
      <div className="row">
        <Act
          label="Read own tasks again"
          words={`List the task files in ${folder}`}
          testId="read-tasks"
          onPress={() => station.send({ type: "read_training_files" })}
        />
      </div>
      <p className="quiet">
        Your own tasks are files in <span className="path">{folder}</span>
      </p>
      {problems.map((words) => (
        <p key={words} className="warning-text" data-testid="task-problem">
          <Icon name="warning" /> {words}
        </p>
      ))}
    </div>
  );
}

/** Render the buttons that start a quiz. */
function Quizzes() {
  const station = useStation();
  const ready = useApp((state) => state.session?.airways === "found");
  return (
    <>
      <h3>Quizzes</h3>
      <div className="row">
        <Act
          label="Name the opening"
          words="Which segment is behind the opening in the middle of the picture?"
          disabled={!ready}
          testId="quiz-name-opening"
          onPress={() => station.startQuiz("name-opening")}
        />
        <Act
          label="Where are you?"
          words="In which segment is the tip?"
          disabled={!ready}
          testId="quiz-where-are-you"
          onPress={() => station.startQuiz("where-are-you")}
        />
        <Act
          label="Three slices"
          words="Which opening of the fork leads to the place where three slices meet?"
          disabled={!ready}
          testId="quiz-slices"
          onPress={() => station.startQuiz("slices")}
        />
      </div>
    </>
  );
}

/** Render the question of the quiz, its choices, and the result of the answer. */
function RunningQuiz({ quiz }: { quiz: QuizInfo }) {
  const station = useStation();
  const moved = useApp((state) => !isAtQuestion(state, quiz));
  const answer = answerText(quiz);
  const result = `${quiz.num_right} of ${quiz.num_questions} right`;
  return (
    <>
      <p className="quiet numbers" data-testid="quiz-number">
        Question {quiz.number} of {quiz.num_questions}
      </p>
      <p>
        <strong>{questionText(quiz)}</strong>
      </p>
      <div className="quiz-choices">
        {quiz.choices.map((name) => (
          <Act
            key={name}
            label={name}
            words={`Answer ${name}`}
            disabled={quiz.given !== null}
            testId="quiz-choice"
            onPress={() => station.send({ type: "answer_quiz", name })}
          />
        ))}
      </div>
      <p role="status" className={quiz.given === quiz.answer ? undefined : "warning-text"} data-testid="quiz-answer">
        {answer ?? ""}
      </p>
      {moved || quiz.kind === "slices" ? (
        <Act
          label="Back to the question"
          words="Place the tip and the slices again where the question was asked"
          testId="quiz-back"
          onPress={() => station.send({ type: "repeat_question" })}
        />
      ) : null}
      {quiz.is_over ? (
        <p>
          <strong data-testid="quiz-result">{result}</strong>
        </p>
      ) : answer === null ? null : (
        <Act
          kind="primary"
          label="Next question"
          words="Go to the next question"
          testId="quiz-next"
          onPress={() => station.send({ type: "next_question" })}
        />
      )}
      <Act
        kind={quiz.is_over ? "primary" : "plain"}
        label={quiz.is_over ? "Close" : "End the quiz"}
        words="End the quiz"
        testId="quiz-stop"
        onPress={() => station.send({ type: "stop_quiz" })}
      />
    </>
  );
}

/** Render the progress of the attempt, its clock, and the button that ends it. */
function RunningAttempt({ attempt }: { attempt: Attempt }) {
  const station = useStation();
  return (
    <>
      <p>
        <strong data-testid="attempt-title">{attempt.task.title}</strong>
      </p>
      <AttemptClock attempt={attempt} />
      <p data-testid="attempt-progress">{progressText(attempt)}</p>
      <LearnerOf learner={attempt.running.learner} />
      <VoiceSwitch />
      <VoiceFeedback running={attempt.running} />
      {attempt.running.steps_done.length === 0 ? null : (
        <p className="quiet">Done: {attempt.running.steps_done.join(", ")}</p>
      )}
      <Act
        icon={attempt.running.paused ? "play" : "pause"}
        label={attempt.running.paused ? "Continue" : "Pause"}
        words={
          attempt.running.paused
            ? "Continue the attempt: the clock runs again"
            : "Pause: the clock stops and the tip does not move. A paused attempt is scored, but does not count."
        }
        keys={keyOf("pause_task")}
        testId="pause-task"
        onPress={station.pauseTask}
      />
      <Act
        kind="primary"
        icon="stop"
        label="End the task"
        words="End the attempt, and see its score"
        testId="stop-task"
        onPress={() => station.send({ type: "stop_task" })}
      />
      <p className="quiet">
        <kbd>W</kbd> <kbd>S</kbd> advance and withdraw, <kbd>{"\u2191"}</kbd> <kbd>{"\u2193"}</kbd> bend the tip,{" "}
        <kbd>A</kbd> <kbd>D</kbd> rotate; on a touch screen, use the sticks. Other modes, instruments and steps are
        disabled until you end the task.
      </p>
    </>
  );
}

/** Render the learner to whom the score of the running attempt is stored. */
function LearnerOf({ learner }: { learner: string | null }) {
  const stores = useApp((state) => state.training?.course.stores ?? false);
  if (!stores) return null;
  return (
    <p className="quiet" data-testid="attempt-learner">
      {learner === null ? "No learner: the score is not stored" : `Score stored for ${learner}`}
    </p>
  );
}

/** Interval at which the clock of an attempt is updated, ms. */
const CLOCK_MS = 200;

/** Render the time of an attempt. */
export function AttemptClock({ attempt }: { attempt: Attempt }) {
  const { running } = attempt;
  const [since, setSince] = useState({ running, atMs: performance.now() });
  const [nowMs, setNowMs] = useState(since.atMs);
  if (since.running !== running) setSince({ running, atMs: performance.now() });
  useEffect(() => {
    const timer = setInterval(() => setNowMs(performance.now()), CLOCK_MS);
    return () => clearInterval(timer);
  }, []);
  const sinceMs = running.paused ? 0 : Math.max(nowMs - since.atMs, 0);
  const elapsedS = running.elapsed_s + sinceMs / 1000;
  return (
    <p className="attempt-clock numbers" data-testid="attempt-clock">
      {timeText(attempt, elapsedS)}
    </p>
  );
}

function Scores({ scores, verdict }: { scores: readonly FlightScore[]; verdict: string | null }) {
  const station = useStation();
  const flights = useApp((state) => state.flights);
  const unscored = flights.filter(
    ({ number, state }) => state !== "recording" && !scores.some(({ flight }) => flight === number),
  );
  const name = (number: number) => flights.find((one) => one.number === number)?.name ?? `Flight ${number}`;
  return (
    <>
      <h3>Scores</h3>
      {scores.length === 0 ? <p className="quiet">No flight has been scored since this case was opened.</p> : null}
      <ul className="key-list" aria-label="Scores" data-testid="scores">
        {scores.map((score) => (
          <li key={score.flight} className="key task">
            <div className="key-head">
              <span className="flight-words">
                <strong>{name(score.flight)}</strong>
                <span className="quiet numbers">
                  {outcomeText(score)}, {clock(score.published.time_s)}
                </span>
              </span>
              <Act
                label="Score"
                words={`Show the score of ${name(score.flight)}`}
                testId={`score-${score.flight}`}
                onPress={() => station.ui({ openScore: score.flight })}
              />
            </div>
            {score.doubts.length === 0 ? null : (
              <p className="warning-text">
                <Icon name="warning" /> Does not count
              </p>
            )}
          </li>
        ))}
        {unscored.map(({ number }) => (
          <li key={number} className="key task">
            <div className="key-head">
              <span className="flight-words">
                <strong>{name(number)}</strong>
                <span className="quiet">not scored yet</span>
              </span>
              <Act
                label="Score it"
                words={`Score ${name(number)} by its task, or as an inspection of all segments. The score of a task is stored for the learner who flew.`}
                testId={`score-flight-${number}`}
                onPress={() => station.send({ type: "score_flight", number })}
              />
            </div>
          </li>
        ))}
      </ul>
      {verdict === null ? null : <p data-testid="mastery">{sentence(verdict)}</p>}
    </>
  );
}
