/** Recorded flights: the switch that starts and stops a recording, and the flights recorded in the case. */

import { useState } from "react";
import { Button, Input, Slider, SliderThumb, SliderTrack, TextArea, TextField } from "react-aria-components";
import { clock as timeOfDay } from "../state/format";
import { clock } from "../state/playing";
import type { FlightInfo } from "../wire/messages";
import { useApp, useStation } from "./context";
import { Act, SwitchKey, Tip } from "./controls";
import { SaveVideo } from "./FilmDialog";
import { Icon } from "./icons";

/** Render the switch that starts and stops the recording of a flight. */
export function RecordSwitch() {
  const station = useStation();
  const recording = useApp((state) => state.devices?.recording ?? null);
  const keeps = useApp((state) => state.session?.saving.keeps ?? false);
  return (
    <SwitchKey
      words={
        keeps
          ? "Record every movement of the tip. The flight is stored in this case."
          : "Record to a file on this machine. carina fly renders the file as a video, exactly as flown."
      }
      label={recording === null ? "Record" : "Stop recording"}
      on={recording !== null}
      testId="record"
      onChange={() => station.send({ type: recording === null ? "start_recording" : "stop_recording" })}
    />
  );
}

/** Render the flight being recorded, or the list of the flights recorded in the case. */
export function FlightList() {
  const recording = useApp((state) => state.devices?.recording ?? null);
  const keeps = useApp((state) => state.session?.saving.keeps ?? false);
  const flights = useApp((state) => state.flights);
  const [open, setOpen] = useState<number | null>(null);
  if (!keeps) return recording === null ? null : <p className="quiet path">{recording}</p>;
  if (flights.length === 0) return <p className="quiet">Recorded flights are stored in this case and listed here.</p>;
  return (
    <ol className="key-list flights" aria-label="Recorded flights" data-testid="flights">
      {flights.map((flight, n) => (
        <FlightRow
          key={flight.number}
          flight={flight}
          first={n === 0}
          last={n === flights.length - 1}
          open={open === flight.number}
          onOpen={() => setOpen(open === flight.number ? null : flight.number)}
        />
      ))}
    </ol>
  );
}

interface RowProps {
  flight: FlightInfo;
  first: boolean;
  last: boolean;
  open: boolean;
  onOpen: () => void;
}

function FlightRow({ flight, first, last, open, onOpen }: RowProps) {
  const station = useStation();
  const isRecording = flight.state === "recording";
  const isOn = useApp((state) => state.flownFlight === flight.number && state.replaying.on);
  const isExpert = flight.is_expert;
  const when = flight.begun_s === null ? "" : timeOfDay(flight.begun_s, Date.now());
  return (
    <li className={isRecording ? "key here" : "key"} data-testid="flight">
      <div className="key-head flight-head">
        <Act
          kind="icon"
          icon={isOn ? "pause" : "play"}
          words={
            isOn
              ? `Pause ${flight.name}`
              : `Replay ${flight.name} with the current view settings. Any movement you make stops it.`
          }
          disabled={isRecording || flight.length_s <= 0}
          testId="flight-play"
          onPress={() => station.playFlight(flight.number)}
        />
        <span className="flight-words">
          <strong>{flight.name}</strong>
          <span className="quiet numbers">
            {isExpert ? "expert's, " : ""}
            {isRecording ? "recording" : clock(flight.length_s)} {when === "" ? "" : `\u00b7 ${when}`}
          </span>
        </span>
        <Tip words={open ? "Close" : "Rename, describe, move, download, save as video or delete this flight"}>
          <Button
            className="button icon quiet"
            aria-label={`Change ${flight.name}`}
            aria-expanded={open}
            data-testid="flight-more"
            onPress={onOpen}
          >
            <Icon name={open ? "down" : "chevron"} />
          </Button>
        </Tip>
      </div>
      <Bar flight={flight} />
      {flight.words === "" || open ? null : <p className="flight-note quiet">{flight.words}</p>}
      {flight.state === "cut-off" ? (
        <p className="flight-note warning-text">Incomplete: Carina was stopped during this recording.</p>
      ) : null}
      {open ? <FlightTools flight={flight} first={first} last={last} /> : null}
    </li>
  );
}

/** Render the position slider of the flight that is replayed; nothing for any other flight of the list. */
function Bar({ flight }: { flight: FlightInfo }) {
  const station = useStation();
  const atS = useApp((state) => (state.flownFlight === flight.number ? state.replaying.atS : null));
  // After another input has moved the tip, the slider stays at its last position and is drawn as inactive.
  const on = useApp((state) => state.pose?.flight?.number === flight.number);
  if (atS === null || flight.length_s <= 0) return null;
  return (
    <div className="flight-bar">
      <Slider
        className={on ? "path-slider" : "path-slider off-flight"}
        aria-label={`Time in ${flight.name} (seconds)`}
        minValue={0}
        maxValue={flight.length_s}
        step={0.01}
        value={Math.min(atS, flight.length_s)}
        onChange={(value) => station.replayer.seek(value)}
      >
        <SliderTrack className="path-track">
          <div className="path-line" />
          <div className="path-done" style={{ width: `${(100 * Math.min(atS / flight.length_s, 1)).toFixed(2)}%` }} />
          <SliderThumb className="path-thumb" />
        </SliderTrack>
      </Slider>
    </div>
  );
}

function FlightTools({ flight, first, last }: { flight: FlightInfo; first: boolean; last: boolean }) {
  const station = useStation();
  const { number } = flight;
  const isRecording = flight.state === "recording";
  const [asking, setAsking] = useState(false);
  const isExpert = flight.is_expert;
  return (
    <div className="key-tools">
      <Written
        label="Flight name"
        testId="flight-name"
        maxLength={80}
        value={flight.name}
        onChange={(name) => (name === "" ? false : station.send({ type: "rename_flight", number, name }))}
      />
      <Written
        label="Description"
        testId="flight-words"
        maxLength={4000}
        long
        value={flight.words}
        onChange={(words) => station.send({ type: "describe_flight", number, words })}
      />
      <Act
        label={isExpert ? "No longer the expert's" : "Mark as expert's"}
        words={
          isExpert ? "Remove the mark" : "Compare the flights of trainees with this one, and show its tip as a ghost"
        }
        disabled={isRecording}
        testId="flight-expert"
        onPress={() => station.send({ type: "mark_expert", number: isExpert ? null : number })}
      />
      <div className="row">
        <SaveVideo flight={{ kind: "recording", number }} testId="flight-video" />
      </div>
      {asking ? (
        <div
          role="alertdialog"
          aria-label="Delete this flight?"
          ref={(shown) => shown?.scrollIntoView({ block: "nearest" })}
        >
          <p>Delete this flight? This cannot be undone.</p>
          <div className="row">
            <Act
              label="Delete"
              words="Delete this flight from the case"
              testId="flight-delete"
              onPress={() => station.send({ type: "remove_flight", number })}
            />
            <Act kind="quiet" label="Keep" words="Keep this flight" onPress={() => setAsking(false)} />
          </div>
        </div>
      ) : (
        <div className="row">
          <Act
            icon="file"
            label="Download"
            words="Download this flight, to replay it elsewhere"
            disabled={isRecording}
            testId="flight-download"
            onPress={() => void station.transfers.takeFlight(number)}
          />
          <Act
            kind="icon"
            icon="up"
            words="Move up"
            disabled={first}
            testId="flight-up"
            onPress={() => station.send({ type: "move_flight", number, by: -1 })}
          />
          <Act
            kind="icon"
            icon="down"
            words="Move down"
            disabled={last}
            testId="flight-down"
            onPress={() => station.send({ type: "move_flight", number, by: 1 })}
          />
          <Act
            kind="icon"
            icon="close"
            words="Delete"
            disabled={isRecording}
            testId="flight-remove"
            onPress={() => setAsking(true)}
          />
        </div>
      )}
    </div>
  );
}

interface WrittenProps {
  label: string;
  testId: string;
  maxLength: number;
  long?: boolean;
  value: string;
  /** Handle a changed text; return false to restore the previous text in the field. */
  onChange: (value: string) => boolean;
}

/** Render a text field. The text is sent on Enter or loss of focus, and restored on Escape. */
function Written({ label, testId, maxLength, long = false, value, onChange }: WrittenProps) {
  const [typed, setTyped] = useState<string | null>(null);
  const [before, setBefore] = useState(value);
  if (before !== value) {
    // The stored text differs from the last known one: the server has answered, or another window has changed it.
    setBefore(value);
    setTyped(null);
  }
  const send = () => {
    const now = typed?.trim() ?? value;
    if (now === value || !onChange(now)) setTyped(null);
  };
  const field = {
    "data-testid": testId,
    placeholder: label,
    onBlur: send,
    onKeyDown: (event: React.KeyboardEvent<HTMLInputElement | HTMLTextAreaElement>) => {
      if (event.key === "Escape") setTyped(null);
      else if (event.key === "Enter" && !event.shiftKey) event.currentTarget.blur();
    },
  };
  return (
    <TextField className="field" aria-label={label} maxLength={maxLength} value={typed ?? value} onChange={setTyped}>
      {long ? <TextArea rows={2} {...field} /> : <Input {...field} />}
    </TextField>
  );
}
