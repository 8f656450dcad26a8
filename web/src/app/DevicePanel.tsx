/** Panel of input devices: their list and values, their movement settings, and their calibration to the patient. */

import { useState } from "react";
import { Input, TextField } from "react-aria-components";
import { keyOf } from "../input/keymap";
import { coordinates, fixed, plural } from "../state/format";
import { penOffText } from "../state/pen";
import { asVec3 } from "../state/vec";
import type { DeviceControls, DeviceInfo, DevicesMessage } from "../wire/messages";
import { useApp, useStation } from "./context";
import { Act, SwitchKey } from "./controls";
import type { CalibrationPair } from "./devices";
import { Figure } from "./Figure";
import { FlightList, RecordSwitch } from "./FlightList";
import { PhoneGroup } from "./PhoneGroup";
import { WatchGroup } from "./WatchGroup";

const CONTROLS = [
  ["absolute", "Absolute", "The tip follows the pen's position in the patient. Needs a calibration."],
  ["relative", "Relative", "The tip follows the hand's movement"],
  ["path", "Path", "The tip moves forward and back along the path; turning the device turns the view"],
] as const;
/** Minimum number of point pairs for the registration of a tracker to the patient. */
const MIN_PAIRS = 3;

/** Render the panel of input devices. */
export function DevicePanel() {
  const station = useStation();
  const message = useApp((state) => state.devices);
  // Discard the calibrations in progress when the case changes, because a calibration belongs to one case.
  const caseNumber = useApp((state) => state.session?.case?.number);
  const missing = station.devices.missing();
  return (
    <section className="step-panel device-panel" aria-label="Devices" data-testid="device-panel">
      <div className="panel-head">
        <h2>Devices</h2>
        <Act
          kind="quiet"
          label="Close"
          words="Back to the step"
          keys={keyOf("devices")}
          onPress={() => station.act("devices")}
        />
      </div>
      <div className="step-body">
        {message === null ? (
          <p className="quiet">Open a case before you use a device.</p>
        ) : (
          <>
            <Movement message={message} />
            {message.devices.length === 0 ? (
              <p className="quiet">No input yet. Move a stick on the gamepad, or connect a device below.</p>
            ) : null}
            <Devices key={caseNumber} devices={message.devices} />
            <Connections message={message} />
            <PhoneGroup message={message} />
            <WatchGroup />
            <HeadsetGroup />
            <Recording />
          </>
        )}
        <p className="quiet">
          Gamepads are detected automatically: press any button.
          {missing.length === 0 ? "" : ` Not supported by this browser: ${missing.join(", ")}.`}
        </p>
      </div>
    </section>
  );
}

function Movement({ message }: { message: DevicesMessage }) {
  const station = useStation();
  // Cast to the type with all fields, because the server sends every field, including those that a client may omit.
  const controls = message.controls as Required<DeviceControls>;
  const change = (changed: DeviceControls) =>
    station.send({ type: "set_controls", controls: { ...controls, ...changed } });
  return (
    <div className="group">
      <fieldset className="choices" aria-label="Control mode">
        {CONTROLS.map(([name, title, words]) => (
          <SwitchKey
            key={name}
            words={words}
            label={title}
            on={message.control === name}
            testId={`control-${name}`}
            onChange={() => station.send({ type: "set_control", control: name })}
          />
        ))}
      </fieldset>
      <PenOffset />
      <p className="numbers">
        filter delay {fixed(message.filter_latency_ms, 1)} ms
        <SwitchKey
          words="Smooth hand tremor (adds the delay shown)"
          label={controls.filter_on ? "on" : "off"}
          on={controls.filter_on}
          onChange={() => change({ filter_on: !controls.filter_on })}
        />
      </p>
      <Figure
        label="Smoothing"
        unit="Hz"
        value={controls.min_cutoff_hz}
        choices={[2, 5, 10, 20, 50]}
        onChange={(hz) => (hz === null ? undefined : change({ min_cutoff_hz: hz }))}
      />
      <Figure
        label="Gain"
        unit="x"
        value={controls.gain_mm}
        choices={[0.25, 0.5, 1, 2, 4]}
        onChange={(gain) => (gain === null ? undefined : change({ gain_mm: gain }))}
      />
      <Figure
        label="Speed"
        unit="mm/s"
        value={controls.speed_mm_s}
        choices={[5, 10, 25, 50]}
        onChange={(speed) => (speed === null ? undefined : change({ speed_mm_s: speed }))}
      />
      <SwitchKey
        words="Inverted lever: down = tip down (a real scope is the opposite)"
        label="Invert lever"
        on={controls.lever_inverted}
        onChange={() => change({ lever_inverted: !controls.lever_inverted })}
      />
      <SwitchKey
        words="The device moves the tip only while button 2 is held"
        label="Clutch: hold"
        on={controls.clutch === "hold"}
        onChange={() => change({ clutch: controls.clutch === "hold" ? "always" : "hold" })}
      />
    </div>
  );
}

/** Render the offset between pen (stylus) and tip while the pen positions the tip absolutely; nothing at the pen. */
function PenOffset() {
  const station = useStation();
  const words = useApp((state) => penOffText(state.pen));
  if (words === null) return null;
  return (
    <p className="warning-text numbers">
      The pen is {words} from the tip. The tip catches up as your hand moves.
      <Act
        kind="quiet"
        label="Move to pen"
        words="Move the tip to the pen now"
        keys={keyOf("join_pen")}
        testId="join-pen"
        onPress={() => station.act("join_pen")}
      />
    </p>
  );
}

function HeadsetGroup() {
  const station = useStation();
  const headset = useApp((state) => state.ui.headset);
  if (headset === null || headset === "no-webxr") return null;
  return (
    <div className="group">
      <h3>Headset</h3>
      {headset === "no-headset" ? (
        <p className="quiet">
          No headset found. Start the headset's software, or open Carina in the headset's own browser.
        </p>
      ) : (
        <>
          <Act
            label={headset === "inside" ? "Leave the headset" : "Enter the headset"}
            words="Shows the airway view on a virtual screen. The controllers act as pens."
            testId="headset"
            onPress={() =>
              headset === "inside" ? station.devices.leaveHeadset() : void station.devices.enterHeadset()
            }
          />
          <p className="quiet">
            Hold the trigger to move the tip. Push the stick to advance or withdraw. Grip button: bring the screen in
            front of you. Lower button: next control mode. Upper button: look along the path.
          </p>
        </>
      )}
    </div>
  );
}

/** Calibration of one device, for which the user has begun to collect point pairs. */
interface Begun {
  readonly isOpen: boolean;
  readonly pairs: readonly CalibrationPair[];
}

const NOT_BEGUN: Begun = { isOpen: false, pairs: [] };

/**
 * Render the devices and their calibrations in progress. A calibration is stored here, so that it survives a pause in
 * which its tracker sends nothing and leaves the list.
 */
function Devices({ devices }: { devices: readonly DeviceInfo[] }) {
  const [begun, setBegun] = useState<ReadonlyMap<string, Begun>>(new Map());
  return devices.map((each) => (
    <Device
      key={each.device}
      device={each}
      begun={begun.get(each.device) ?? NOT_BEGUN}
      onCalibrate={(part) =>
        setBegun((old) => new Map(old).set(each.device, { ...(old.get(each.device) ?? NOT_BEGUN), ...part }))
      }
    />
  ));
}

interface DeviceProps {
  device: DeviceInfo;
  begun: Begun;
  onCalibrate: (part: Partial<Begun>) => void;
}

function Device({ device, begun, onCalibrate }: DeviceProps) {
  const station = useStation();
  return (
    <article className="group device" data-testid="device" data-holds={device.holds || undefined}>
      <h3>{device.device}</h3>
      <p className="numbers">{valueText(device)}</p>
      {device.holds ? (
        <p>This device moves the tip.</p>
      ) : (
        <Act
          label="Use"
          words="Let this device move the tip"
          onPress={() => station.send({ type: "take_device", device: device.device })}
        />
      )}
      {device.position_mm === null ? null : <Calibration device={device} begun={begun} onCalibrate={onCalibrate} />}
      {/* The sample counts are last, because their lines grow and must not move the controls under the cursor. */}
      <p className="quiet numbers">
        filter delay {fixed(device.latency_ms, 1)} ms, {plural(device.num_used, "sample")}
        {device.num_ignored === 0 ? "" : `, ${device.num_ignored} ignored (${device.ignored_words})`}
      </p>
    </article>
  );
}

function valueText(device: DeviceInfo): string {
  const buttons = device.buttons === 0 ? "" : `, buttons ${device.buttons.toString(2)}`;
  if (device.position_mm !== null) {
    return `${device.position_mm.map((v) => fixed(v, 1)).join("  ")} mm${buttons}`;
  }
  if (device.orientation_wxyz !== null)
    return `orientation ${device.orientation_wxyz.map((v) => fixed(v, 2)).join("  ")}`;
  return `${device.axes.map((v) => fixed(v, 2)).join("  ")}${buttons}`;
}

/**
 * Render a calibration by point pairs: the user holds the pen at a place, moves the crosshair there and adds the pair.
 */
function Calibration({ device, begun, onCalibrate }: DeviceProps) {
  const station = useStation();
  const { isOpen, pairs } = begun;
  const setPairs = (pairs: readonly CalibrationPair[]) => onCalibrate({ pairs });
  const take = () => {
    const place = station.centre();
    if (device.position_mm === null || place === null) return;
    setPairs([...pairs, { tracker: asVec3(device.position_mm), patient: place }]);
  };
  const register = () => {
    station.send({
      type: "calibrate",
      device: device.device,
      tracker_mm: pairs.map((pair) => pair.tracker),
      patient_lps: pairs.map((pair) => pair.patient),
    });
    setPairs([]);
  };
  return (
    <details
      className="calibration"
      open={isOpen}
      onToggle={({ currentTarget }) => {
        if (currentTarget.open !== isOpen) onCalibrate({ isOpen: currentTarget.open });
      }}
    >
      <summary>
        {device.registered
          ? `Calibrated${device.residual_mm === null ? "" : `, error ${fixed(device.residual_mm, 1)} mm`}`
          : "Calibrate"}
      </summary>
      <p className="quiet">
        Hold the pen at a landmark, put the crosshair on the same point, then add the pair. Add at least three pairs,
        not all in a straight line.
      </p>
      {pairs.map((pair, n) => (
        // biome-ignore lint/suspicious/noArrayIndexKey: pairs are only added at the end
        <p className="numbers" key={n}>
          {n + 1}: {pair.tracker.map((v) => fixed(v, 1)).join(" ")} {"\u2192"} {coordinates(pair.patient)}
        </p>
      ))}
      <div className="row">
        <Act label="Add pair" words="Pair the pen's position with the crosshair" testId="take-pair" onPress={take} />
        <Act
          label="Register"
          words="Register the tracker to the patient"
          disabled={pairs.length < MIN_PAIRS}
          testId="register"
          onPress={register}
        />
        <Act
          kind="quiet"
          label="Discard"
          words="Discard the point pairs and the calibration"
          onPress={() => {
            setPairs([]);
            station.send({ type: "calibrate", device: device.device, tracker_mm: [], patient_lps: [] });
          }}
        />
      </div>
    </details>
  );
}

function Connections({ message }: { message: DevicesMessage }) {
  const station = useStation();
  const [address, setAddress] = useState("");
  const connect = () => {
    if (address !== "" && station.send({ type: "connect_device", address })) setAddress("");
  };
  return (
    <div className="group">
      <h3>Connections</h3>
      {message.sources.map((source) => (
        <p key={source.address} data-testid="source">
          {source.title}, {source.address}: {source.state}
          {source.state === "live" ? `, ${fixed(source.rate_hz)} Hz` : ""}
          {source.num_bad === 0 ? "" : `, ${plural(source.num_bad, "invalid message")}`} {source.words}
          <Act
            kind="quiet"
            label="Disconnect"
            words={`Disconnect from ${source.address}`}
            onPress={() => station.send({ type: "disconnect_device", address: source.address })}
          />
        </p>
      ))}
      <TextField className="field" value={address} onChange={setAddress} aria-label="Device address">
        <Input
          placeholder="Type and port, such as fastrak:PORT"
          onKeyDown={(event) => (event.key === "Enter" ? connect() : undefined)}
        />
      </TextField>
      <div className="row">
        <Act label="Connect" words="Connect to this device" disabled={address === ""} onPress={connect} />
        <Act
          label="SpaceMouse"
          words="Connect a SpaceMouse (the browser asks which one)"
          disabled={!station.devices.hasHid}
          onPress={() => station.devices.selectSpaceMouse()}
        />
        <Act
          label="Handle"
          words="Connect a USB scope handle (HID; the browser asks which one)"
          disabled={!station.devices.hasHid}
          testId="ask-handle"
          onPress={() => station.devices.selectHandle()}
        />
      </div>
      {message.serial_problem === null ? null : <p className="quiet">{message.serial_problem}</p>}
      {message.serial_ports.length === 0 ? null : (
        <p className="quiet">Serial ports: {message.serial_ports.join(", ")}</p>
      )}
      <SwitchKey
        words="Stream the tip pose to 3D Slicer over OpenIGTLink (port 18944 on this machine)"
        label={message.published_port === null ? "Stream tip pose" : `Streaming on port ${message.published_port}`}
        on={message.published_port !== null}
        onChange={() => station.send({ type: "publish_tip", port: message.published_port === null ? 18944 : null })}
      />
    </div>
  );
}

function Recording() {
  return (
    <div className="group">
      <h3>Recording</h3>
      <RecordSwitch />
      <FlightList />
    </div>
  );
}
