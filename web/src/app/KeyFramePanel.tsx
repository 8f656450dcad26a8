/**
 * Panel of key frames: their list, the playback of the flight through them, and the download of the file from which a
 * video is rendered.
 */

import { useState } from "react";
import { Button, FileTrigger, Input, Slider, SliderThumb, SliderTrack, TextField } from "react-aria-components";
import { keyOf } from "../input/keymap";
import { filesOfPicker } from "../net/upload";
import { mm, sentence } from "../state/format";
import { clock, KEY_SPEEDS_MM_S, PLAY_RATES, passedKey } from "../state/playing";
import type { KeyFramesMessage, ShownKeyFrame } from "../wire/messages";
import { useApp, useStation } from "./context";
import { Act, Choice, Tip } from "./controls";
import { Figure } from "./Figure";
import { SaveVideo } from "./FilmDialog";
import { Icon } from "./icons";

/** Render the panel of key frames. */
export function KeyFramePanel() {
  const station = useStation();
  const keyFrames = useApp((state) => state.keyFrames);
  return (
    <section className="step-panel key-panel" aria-label="Key frames" data-testid="key-panel">
      <div className="panel-head">
        <h2>Key frames</h2>
        <Act
          kind="quiet"
          label="Close"
          words="Back to the step"
          keys={keyOf("key_frames")}
          onPress={() => station.act("key_frames")}
        />
      </div>
      <div className="step-body">
        {keyFrames === null ? (
          <p className="empty">Open a case before you add key frames.</p>
        ) : (
          <>
            <Act
              kind="primary"
              icon="capture"
              label="Add key frame here"
              words="Add the current view as the last key frame"
              keys={keyOf("add_key")}
              testId="add-key"
              onPress={() => station.addKey()}
            />
            {keyFrames.frames.length === 0 ? (
              <p className="empty">
                Fly to a view and add it as a key frame, then fly to the next. Carina flies smoothly from one to the
                next, and can save the flight as a video.
              </p>
            ) : (
              <KeyList keyFrames={keyFrames} />
            )}
            {keyFrames.frames.length > 1 ? <Player keyFrames={keyFrames} /> : null}
            {keyFrames.frames.length > 0 ? <Flight keyFrames={keyFrames} /> : null}
            <KeyFrameFile keyFrames={keyFrames} />
          </>
        )}
      </div>
    </section>
  );
}

function KeyList({ keyFrames }: { keyFrames: KeyFramesMessage }) {
  const [open, setOpen] = useState<string | null>(null);
  const here = useApp((state) =>
    state.pose?.key_frames_s == null ? -1 : passedKey(keyFrames.frames, state.pose.key_frames_s),
  );
  return (
    <ol className="key-list">
      {keyFrames.frames.map((key, n) => (
        <KeyRow
          key={key.key_id}
          frame={key}
          number={n + 1}
          last={n === keyFrames.frames.length - 1}
          here={n === here}
          timed={keyFrames.duration_s > 0}
          open={open === key.key_id}
          onOpen={() => setOpen(open === key.key_id ? null : key.key_id)}
        />
      ))}
    </ol>
  );
}

interface RowProps {
  frame: ShownKeyFrame;
  number: number;
  last: boolean;
  here: boolean;
  timed: boolean;
  open: boolean;
  onOpen: () => void;
}

function KeyRow({ frame, number, last, here, timed, open, onOpen }: RowProps) {
  const station = useStation();
  const id = frame.key_id;
  // Label of the key frame's branch in the list of branches; it replaces an automatic name of the key frame.
  const branch = useApp((state) =>
    frame.branch_id === null ? undefined : state.tree?.byId.get(frame.branch_id)?.label,
  );
  const label = frame.own_name ? frame.name : (branch ?? frame.name);
  return (
    <li className={here ? "key here" : "key"} data-testid="key" aria-current={here ? "true" : undefined}>
      <div className="key-head">
        <Tip words={`Go to key frame ${number}`}>
          <Button
            className="key-name plain-text"
            data-testid="key-go"
            onPress={() => station.send({ type: "show_key_frame", key_id: id })}
          >
            <span className="key-number numbers">{number}</span>
            <strong>{label}</strong>
            {timed ? <span className="quiet numbers">{clock(frame.time_s)}</span> : null}
          </Button>
        </Tip>
        <Tip words={open ? "Close" : "Change this key frame"}>
          <Button
            className="button icon quiet"
            aria-label={`Change key frame ${number}`}
            aria-expanded={open}
            data-testid="key-more"
            onPress={onOpen}
          >
            <Icon name={open ? "down" : "chevron"} />
          </Button>
        </Tip>
      </div>
      {open ? <KeyTools frame={frame} first={number === 1} last={last} /> : null}
    </li>
  );
}

function KeyTools({ frame, first, last }: { frame: ShownKeyFrame; first: boolean; last: boolean }) {
  const station = useStation();
  const key_id = frame.key_id;
  const [name, setName] = useState<string | null>(null);
  const rename = () => {
    if (name !== null) {
      const own = name.trim();
      station.send({ type: "edit_key_frames", edit: { kind: "rename", key_id, name: own === "" ? null : own } });
    }
    setName(null);
  };
  return (
    <div className="key-tools">
      {first ? null : (
        <>
          <p className="quiet numbers">
            {frame.leg_mm === null ? "" : `${mm(frame.leg_mm, 0)} `}
            {frame.through_airways ? "through the airways" : "direct"}
          </p>
          <Figure
            label="Approach speed"
            unit="mm/s"
            value={frame.speed_mm_s}
            choices={KEY_SPEEDS_MM_S}
            none="default"
            testId="key-speed"
            onChange={(speed_mm_s) =>
              station.send({ type: "edit_key_frames", edit: { kind: "speed", key_id, speed_mm_s } })
            }
          />
        </>
      )}
      {name === null ? null : (
        <TextField
          className="field"
          aria-label="Key frame name"
          autoFocus
          maxLength={80}
          value={name}
          onChange={setName}
        >
          <Input
            placeholder="branch name"
            data-testid="key-rename"
            onBlur={rename}
            onKeyDown={(event) => {
              if (event.key === "Enter") rename();
              else if (event.key === "Escape") setName(null);
            }}
          />
        </TextField>
      )}
      <div className="row">
        <Act
          label="Update"
          words="Replace with the current view"
          testId="key-update"
          onPress={() => station.send({ type: "edit_key_frames", edit: { kind: "update", key_id } })}
        />
        <Act
          kind="icon"
          icon="pencil"
          words="Rename. Leave empty to use the branch name."
          testId="key-name"
          onPress={() => setName(frame.own_name ? frame.name : "")}
        />
        <Act
          kind="icon"
          icon="up"
          words="Move earlier"
          disabled={first}
          testId="key-up"
          onPress={() => station.send({ type: "edit_key_frames", edit: { kind: "move", key_id, by: -1 } })}
        />
        <Act
          kind="icon"
          icon="down"
          words="Move later"
          disabled={last}
          testId="key-down"
          onPress={() => station.send({ type: "edit_key_frames", edit: { kind: "move", key_id, by: 1 } })}
        />
        <Act
          kind="icon"
          icon="close"
          words="Remove"
          testId="key-remove"
          onPress={() => station.send({ type: "edit_key_frames", edit: { kind: "remove", key_id } })}
        />
      </div>
    </div>
  );
}

/** Render the playback buttons and the position slider of the flight through the key frames. */
function Player({ keyFrames }: { keyFrames: KeyFramesMessage }) {
  const station = useStation();
  const playing = useApp((state) => state.playing);
  // After another input has moved the tip, the slider stays at its last position and is drawn as inactive.
  const on = useApp((state) => state.pose?.key_frames_s != null);
  if (keyFrames.duration_s <= 0) {
    return keyFrames.problem === null ? null : <p className="warning-text">{sentence(keyFrames.problem)}</p>;
  }
  return (
    <div className="group player">
      <div className="row">
        <Act
          icon={playing.on ? "pause" : "play"}
          label={playing.on ? "Pause" : "Play"}
          words={
            playing.on ? "Pause the playback" : "Fly through the key frames. Any movement you make stops the playback."
          }
          testId="play-keys"
          onPress={() => station.playKeys()}
        />
        <Act
          kind="icon"
          icon="stop"
          words="Back to the first key frame"
          testId="stop-keys"
          onPress={() => station.player.stop()}
        />
        <span className="space" />
        <Choice
          name="Playback speed"
          value={String(playing.rate)}
          choices={PLAY_RATES.map((rate) => ({
            value: String(rate),
            label: rate === 0.5 ? "\u00bd\u00d7" : `${rate}\u00d7`,
            words: rate === 1 ? "Play at the set speeds" : rate < 1 ? "Play slower" : "Play faster",
          }))}
          onChange={(rate) => station.player.setRate(Number(rate))}
        />
      </div>
      <Slider
        className={on ? "path-slider" : "path-slider off-flight"}
        aria-label="Time in the flight (seconds)"
        minValue={0}
        maxValue={keyFrames.duration_s}
        step={0.01}
        value={Math.min(playing.atS, keyFrames.duration_s)}
        onChange={(value) => station.player.seek(value)}
      >
        <SliderTrack className="path-track">
          <div className="path-line" />
          <div className="path-done" style={{ width: share(playing.atS, keyFrames.duration_s) }} />
          {keyFrames.frames.map((key) => (
            <span key={key.key_id} className="fork" style={{ left: share(key.time_s, keyFrames.duration_s) }} />
          ))}
          <SliderThumb className="path-thumb" />
        </SliderTrack>
      </Slider>
      <p className="numbers" data-testid="keys-clock">
        {clock(playing.atS)} <span className="quiet">of {clock(keyFrames.duration_s)}</span>
      </p>
    </div>
  );
}

const share = (seconds: number, of: number): string =>
  `${(100 * Math.min(Math.max(seconds / Math.max(of, 1e-6), 0), 1)).toFixed(2)}%`;

function Flight({ keyFrames }: { keyFrames: KeyFramesMessage }) {
  const station = useStation();
  return (
    <div className="group">
      <Figure
        label="Speed"
        words="Speed for every leg without its own"
        unit="mm/s"
        value={keyFrames.speed_mm_s}
        choices={KEY_SPEEDS_MM_S}
        testId="keys-speed"
        onChange={(speed_mm_s) => station.send({ type: "set_key_frame_flight", speed_mm_s, through: null })}
      />
      <Choice<KeyFramesMessage["through"]>
        name="Path between key frames"
        value={keyFrames.through}
        choices={[
          {
            value: "airways",
            label: "Through the airways",
            words: "Along the airways if both key frames are inside them, otherwise direct",
          },
          {
            value: "space",
            label: "Direct",
            words: "A smooth curve directly from view to view; it may pass through tissue",
          },
        ]}
        onChange={(through) => station.send({ type: "set_key_frame_flight", speed_mm_s: null, through })}
      />
    </div>
  );
}

function KeyFrameFile({ keyFrames }: { keyFrames: KeyFramesMessage }) {
  const station = useStation();
  return (
    <div className="group">
      <div className="row">
        <Act
          icon="file"
          label="Save"
          words="Save to a file. Open it again in this case."
          disabled={keyFrames.frames.length === 0}
          testId="save-keys"
          onPress={() => void station.transfers.takeKeys()}
        />
        <FileTrigger
          acceptedFileTypes={[".json"]}
          onSelect={(list) => {
            if (list !== null && list.length > 0) void station.transfers.upload(filesOfPicker(list), "keys");
          }}
        >
          <Tip words="Open key frames saved from this case. Undo restores the current ones.">
            <Button className="button" data-testid="open-keys">
              <Icon name="folder" />
              {"Open\u2026"}
            </Button>
          </Tip>
        </FileTrigger>
      </div>
      <SaveVideo flight={{ kind: "key_frames" }} testId="keys-video" />
    </div>
  );
}
