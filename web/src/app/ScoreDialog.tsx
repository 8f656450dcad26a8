/** Dialog with the score of a flight: the published scores, measures without a mark, segments, and faults to replay. */

import { useState } from "react";
import { Dialog, Heading, Modal, ModalOverlay } from "react-aria-components";
import { keyOf } from "../input/keymap";
import { sentence } from "../state/format";
import { clock } from "../state/playing";
import { SCORE_DEFINITIONS } from "../state/score-definitions";
import { expertFlight, outcomeText, publishedRows, type ScoreRow, unmarkedRows } from "../state/training";
import type { FlightScore } from "../wire/messages";
import { useApp, useStation } from "./context";
import { Act } from "./controls";
import { Icon } from "./icons";
import { ScoreMap, Timeline } from "./ScoreMap";

/** Render the dialog with the score of the flight that the user has chosen, or that has just ended. */
export function ScoreDialog() {
  const station = useStation();
  const open = useApp((state) => state.ui.openScore);
  const score = useApp((state) => state.training?.scores.find(({ flight }) => flight === open) ?? null);
  const close = () => station.ui({ openScore: null });
  return (
    <ModalOverlay className="dialog-back" isOpen={score !== null} isDismissable onOpenChange={close}>
      <Modal className="dialog score-dialog">
        <Dialog data-testid="score-dialog">
          {score === null ? null : (
            <>
              <div className="dialog-head">
                <Heading slot="title">{score.task_title}</Heading>
                <Act
                  icon="file"
                  label="Save the log"
                  words="Save events, poses and scores of this flight as CSV files, and as xAPI statements"
                  testId="save-log"
                  onPress={() => void station.transfers.takeFlightLog(score.flight)}
                />
                <Act label="Print" words="Print this score on one page" testId="print-score" onPress={() => print()} />
                <Act kind="icon" icon="close" words="Close" keys={keyOf("leave")} onPress={close} />
              </div>
              <ScoreContent score={score} />
            </>
          )}
        </Dialog>
      </Modal>
    </ModalOverlay>
  );
}

function ScoreContent({ score }: { score: FlightScore }) {
  const groups = useApp((state) => state.training?.references ?? null) ?? [];
  // The published values are those of an inspection of all segments.
  const references = score.is_inspection ? groups : [];
  const verdict = useApp((state) => state.training?.verdict ?? null);
  const name = useApp((state) => state.flights.find(({ number }) => number === score.flight)?.name ?? "");
  return (
    <div className="score-content">
      <p>
        <strong data-testid="score-outcome">{outcomeText(score)}</strong>. <span className="quiet">{name}</span>
      </p>
      {score.doubts.map((words) => (
        <p key={words} className="warning-text" data-testid="score-doubt">
          <Icon name="warning" /> Does not count: {words}
        </p>
      ))}
      <div className="score-tables">
        <div>
          <table className="score-table numbers">
            <thead>
              <tr>
                <th scope="col">Published scores</th>
                <th scope="col">This flight</th>
                {references.map(({ group, source }) => (
                  <th scope="col" key={group} title={source}>
                    {group}
                  </th>
                ))}
              </tr>
            </thead>
            <tbody>
              {publishedRows(score, references).map((row) => (
                <Row key={row.title} row={row} />
              ))}
            </tbody>
          </table>
          {references.length === 0 ? null : (
            <p className="quiet">
              Columns at the right: {references[0]?.source}, measured with another system; not directly comparable, and
              no pass marks.
            </p>
          )}
          <Comparison score={score} />
        </div>
        <div>
          <table className="score-table unmarked numbers">
            <thead>
              <tr>
                <th scope="col">Measures without a published threshold</th>
                <th scope="col">This flight</th>
              </tr>
            </thead>
            <tbody>
              {unmarkedRows(score).map((row) => (
                <Row key={row.title} row={row} />
              ))}
            </tbody>
          </table>
          <div className="score-pictures">
            <ScoreMap score={score} />
            <div>
              <Moments score={score} />
              <Expert score={score} />
            </div>
          </div>
          <Timeline score={score} />
        </div>
      </div>
      <Segments title="Seen" names={score.seen} />
      {/* A task other than an inspection does not ask for the other segments. */}
      {score.is_inspection ? <Segments title="Not seen" names={score.not_seen} /> : null}
      <Segments title="Not in this case" names={score.absent} />
      {score.is_inspection && verdict !== null ? <p>{sentence(verdict)}</p> : null}
      {score.notes.map((words) => (
        <p key={words} className="quiet">
          {sentence(words)}
        </p>
      ))}
      <Definitions />
    </div>
  );
}

/** Render the button that shows the definitions of the values that are in no table. */
function Definitions() {
  const [shown, setShown] = useState(false);
  return (
    <>
      <p className="quiet">
        A score is for training, and no assessment of a person.{" "}
        <button
          type="button"
          className="definition-key"
          aria-expanded={shown}
          data-testid="definitions-key"
          onClick={() => setShown(!shown)}
        >
          {shown ? "Hide the definitions" : "Definitions and sources"}
        </button>
      </p>
      {shown ? (
        <dl className="definitions" data-testid="definitions">
          {SCORE_DEFINITIONS.map(({ title, words }) => (
            <div key={title}>
              <dt>{title}</dt>
              <dd>{words}</dd>
            </div>
          ))}
        </dl>
      ) : null}
    </>
  );
}

/** Render a score; a click on its title shows the definition with its source. */
function Row({ row }: { row: ScoreRow }) {
  const [shown, setShown] = useState(false);
  return (
    <tr>
      <th scope="row">
        <button
          type="button"
          className="definition-key"
          title={row.words}
          aria-expanded={shown}
          data-testid="score-row"
          onClick={() => setShown(!shown)}
        >
          {row.title}
        </button>
        <span className="definition" data-shown={shown || undefined}>
          {row.words}
        </span>
      </th>
      <td>{row.value}</td>
      {row.references.map((value, n) => (
        // The columns are those of the groups, in a fixed order.
        // biome-ignore lint/suspicious/noArrayIndexKey: the order of the columns is fixed
        <td key={n} className="quiet">
          {value}
        </td>
      ))}
    </tr>
  );
}

function Segments({ title, names }: { title: string; names: readonly string[] }) {
  return names.length === 0 ? null : (
    <p>
      <strong>{title}</strong>: {names.join(", ")}
    </p>
  );
}

/** Render the button that compares the flight with the expert's; nothing once they are compared. */
function Expert({ score }: { score: FlightScore }) {
  const station = useStation();
  const isExpert = useApp((state) => expertFlight(state) === score.flight);
  if (isExpert) return <p className="quiet">This flight is marked as the expert's.</p>;
  if (score.comparison.length > 0) return null;
  return (
    <Act
      label="Compare with the expert"
      words="Compare with the flight that is marked as the expert's; without one, with the simulated drive of the instrument"
      testId="compare-expert"
      onPress={() => station.send({ type: "compare_flight", number: score.flight })}
    />
  );
}

/** Render the differences from the expert's flight. */
function Comparison({ score }: { score: FlightScore }) {
  const name = useApp((state) => state.flights.find((flight) => flight.is_expert)?.name ?? "the expert");
  if (score.comparison.length === 0) return null;
  return (
    <div data-testid="comparison">
      <strong>Compared with {name}</strong>, by place:
      <ul className="comparison">
        {score.comparison.map((words) => (
          <li key={words}>{sentence(words)}</li>
        ))}
      </ul>
    </div>
  );
}

function Moments({ score }: { score: FlightScore }) {
  const station = useStation();
  if (score.moments.length === 0) return null;
  return (
    <div className="score-moments">
      <strong>To look at again</strong>
      {score.moments.map(({ time_s, words }) => (
        <Act
          key={`${time_s} ${words}`}
          icon="play"
          label={`${clock(time_s)} ${words}`}
          words="Replay the flight from 3 s before this moment"
          testId="score-moment"
          onPress={() => station.replayMoment(score.flight, time_s)}
        />
      ))}
    </div>
  );
}
