/** Status bar: state of the machine, mode, undo, the cursor, and the permanent sentence *not a medical device*. */

import { useEffect, useState } from "react";
import { keyOf } from "../input/keymap";
import { greyWindow } from "../state/app-state";
import { coordinates, fixed, windowText } from "../state/format";
import { trainingLayout } from "../state/training";
import { asVec3 } from "../state/vec";
import { useApp, useStation } from "./context";
import { Act } from "./controls";
import { MachineStatus } from "./MachineStatus";
import { ToolHint } from "./ToolTag";

/** Render the status bar. */
export function StatusBar() {
  const station = useStation();
  const mode = useApp((state) => state.session?.mode ?? "free");
  const control = useApp((state) =>
    state.devices?.devices.some((device) => device.holds) === true && state.session?.mode === "free"
      ? state.devices.control
      : null,
  );
  const recording = useApp((state) => state.devices?.recording ?? null);
  const isHu = useApp((state) => state.session?.case?.is_hu ?? true);
  const width = useApp((state) => greyWindow(state).width_hu);
  const level = useApp((state) => greyWindow(state).level_hu);
  const undo = useApp((state) => state.session?.can_undo ?? null);
  const redo = useApp((state) => state.session?.can_redo ?? null);
  const armed = useApp((state) => state.ui.armed !== null);
  const watches = useApp((state) => state.watches);
  const trains = useApp((state) => trainingLayout(state) !== undefined);
  return (
    <footer className="status-bar numbers">
      <MachineStatus />
      <ConnectionText />
      <span data-testid="mode">mode: {control ?? mode} [M]</span>
      {recording === null ? null : <span className="warning-text">recording</span>}
      <span className="wide spare" hidden={armed}>
        {windowText(width, level)}
        {isHu ? " HU" : ""}
      </span>
      <span className="undo" hidden={watches}>
        {undo === null || trains ? null : (
          <Act
            kind="quiet"
            icon="undo"
            label={`undo: ${undo}`}
            words={`Undo: ${undo}`}
            keys={keyOf("undo")}
            onPress={() => station.act("undo")}
          />
        )}
        {redo === null || trains ? null : (
          <Act
            kind="quiet"
            icon="redo"
            label={`redo: ${redo}`}
            words={`Redo: ${redo}`}
            keys={keyOf("redo")}
            onPress={() => station.act("redo")}
          />
        )}
      </span>
      <ToolHint />
      <span className="space" />
      <CursorText />
      <strong className="not-device">not a medical device</strong>
    </footer>
  );
}

/**
 * Render the position and the voxel value under the cursor. Both are from one answer of the server, so that they belong
 * together.
 */
function CursorText() {
  const cursor = useApp((state) => state.ui.cursorLps);
  const probed = useApp((state) => state.probed);
  const isHu = useApp((state) => state.session?.case?.is_hu ?? true);
  if (cursor === null) return null;
  const value = probed?.voxel_value ?? null;
  return (
    <span className="cursor wide" data-testid="cursor" title="The voxel under the cursor">
      {coordinates(probed === null ? cursor : asVec3(probed.lps))}
      <strong>
        {probed === null ? "" : value === null ? "outside the scan" : `${fixed(value)}${isHu ? " HU" : " (not HU)"}`}
      </strong>
    </span>
  );
}

function ConnectionText() {
  const station = useStation();
  const connection = useApp((state) => state.connection);
  const [now, setNow] = useState(() => performance.now());
  const waiting = connection.retryAtMs !== null;
  useEffect(() => {
    if (!waiting) return;
    const timer = setInterval(() => setNow(performance.now()), 500);
    return () => clearInterval(timer);
  }, [waiting]);
  switch (connection.status) {
    case "open":
      return null;
    case "connecting":
      return <span className="connection warning-text">connecting{"\u2026"}</span>;
    case "lost": {
      const seconds = Math.max(Math.ceil(((connection.retryAtMs ?? now) - now) / 1000), 0);
      return (
        <span className="connection error-text" role="alert" data-testid="connection-lost">
          connection lost, next try in {seconds} s
          <Act kind="quiet" label="Try now" words="Connect again now" onPress={station.reconnect} />
        </span>
      );
    }
    case "refused":
      return (
        <span className="connection error-text" role="alert">
          {connection.reason}
          <Act kind="quiet" label="Connect" words="Connect this window again" onPress={station.reconnect} />
        </span>
      );
  }
}
