/** Status bar: frame rate, latency and method of the rendering, and the permanent sentence *not a medical device*. */

import { memo, useEffect, useState } from "react";
import { Button, ListBox, ListBoxItem, Popover, Select, SelectValue } from "react-aria-components";
import { keyOf } from "../input/keymap";
import { greyWindow } from "../state/app-state";
import { coordinates, finenessText, fixed, methodText, plural, windowText } from "../state/format";
import { asVec3 } from "../state/vec";
import { LEAD_VIEW } from "../wire/views";
import { ClusterPanel } from "./ClusterPanel";
import { useApp, useStation } from "./context";
import { Act, Tip } from "./controls";
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
  return (
    <footer className="status-bar numbers">
      <ConnectionText />
      <PaceText />
      {armed ? null : <FineText />}
      {armed ? null : <MethodText />}
      <ClusterPanel />
      <span data-testid="mode">mode: {control ?? mode} [M]</span>
      {recording === null ? null : <span className="warning-text">recording</span>}
      <span className="wide spare" hidden={armed}>
        {windowText(width, level)}
        {isHu ? " HU" : ""}
      </span>
      <span className="undo" hidden={watches}>
        {undo === null ? null : (
          <Act
            kind="quiet"
            icon="undo"
            label={`undo: ${undo}`}
            words={`Undo: ${undo}`}
            keys={keyOf("undo")}
            onPress={() => station.act("undo")}
          />
        )}
        {redo === null ? null : (
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

const RATES_HZ = [15, 30, 60] as const;

/** Render the selection of the target frame rate, beside the measured frame rate. */
const TargetRate = memo(function TargetRate() {
  const station = useStation();
  const rate = useApp((state) => state.session?.frame_rate_hz ?? 60);
  const choices = RATES_HZ.some((known) => known === rate) ? RATES_HZ : [...RATES_HZ, rate];
  return (
    <Select
      aria-label="Target frame rate while moving"
      className="select small"
      selectedKey={String(rate)}
      onSelectionChange={(key) => {
        if (key !== null && Number(key) !== rate) station.send({ type: "set_frame_rate", rate_hz: Number(key) });
      }}
    >
      <Tip words="Target frame rate while moving (lower = sharper)">
        <Button className="plain-text">
          <SelectValue>{() => `of ${fixed(rate)}/s`}</SelectValue>
        </Button>
      </Tip>
      <Popover className="popover" offset={4}>
        <ListBox className="listbox">
          {choices.map((hz) => (
            <ListBoxItem key={hz} id={String(hz)} textValue={`${fixed(hz)} frames/s`} className="listbox-item">
              {fixed(hz)} frames/s
            </ListBoxItem>
          ))}
        </ListBox>
      </Popover>
    </Select>
  );
});

/** Render the method of the displayed airway picture, which may differ from the selected method. */
function MethodText() {
  const requested = useApp((state) => state.sight.method);
  const made = useApp((state) => state.frames[LEAD_VIEW]?.method ?? null);
  const status = useApp((state) => state.status);
  const byCard = made?.startsWith("gpu-") === true;
  return (
    <span className="wide">
      {methodText(made, requested)}
      {byCard ? ", graphics card" : status === null ? "" : `, ${plural(status.threads, "core")}`}
      <span className="spare">{byCard || status === null ? "" : `, ${simdText(status.simd)}`}</span>
    </span>
  );
}

/** Render the resolution of the displayed airway picture, relative to the size of the view. */
function FineText() {
  const station = useStation();
  const frame = useApp((state) => state.frames[LEAD_VIEW] ?? null);
  if (frame === null) return null;
  if (frame.stands_for !== null) return <span className="warning-text">viewfinder</span>;
  const wanted = station.wall.find(LEAD_VIEW)?.wantedPixels?.width ?? frame.width;
  const words = finenessText(frame, wanted);
  return (
    <span
      className={frame.full ? "wide" : undefined}
      title="Resolution of the airway view: reduced while moving, full at rest"
    >
      {words}
    </span>
  );
}

/** Waiting time for an airway picture, ms, above which the status bar warns. */
const LATE_MS = 700;

function PaceText() {
  const { fps, ageMs, waitingMs } = useApp((state) => state.pace);
  return (
    <>
      <span className="pace" title="Frame rate of the airway view during the last movement">
        frames {fps === null ? "\u2013" : `${fps}/s`} <TargetRate />
      </span>
      {waitingMs > LATE_MS ? (
        <span className="warning-text">{"updating\u2026"}</span>
      ) : (
        <span title="Latency: movement to displayed image">
          latency {ageMs === null ? "\u2013" : `${fixed(ageMs)} ms`}
        </span>
      )}
    </>
  );
}

const SIMD_TEXTS: Readonly<Record<string, string>> = {
  avx512: "AVX-512",
  avx2: "AVX2",
  neon: "NEON",
  portable: "portable",
};
const simdText = (name: string): string => SIMD_TEXTS[name] ?? name;

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
