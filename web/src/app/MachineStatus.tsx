/**
 * State of the machine in the status bar: one dot, with a text only if something is wrong. The dot opens the figures:
 * frame rate, latency, resolution, method and processor.
 */

import { memo, useRef, useState } from "react";
import { Button, ListBox, ListBoxItem, Popover, Select, SelectValue } from "react-aria-components";
import { isLeadShown } from "../state/app-state";
import { clusterText, needsLook } from "../state/cluster-text";
import { finenessText, fixed, methodText, plural } from "../state/format";
import { machineTrouble } from "../state/machine-trouble";
import { LEAD_VIEW } from "../wire/views";
import { ClusterDetails } from "./ClusterDetails";
import { useApp, useStation } from "./context";
import { Act, giveKeysBack, Tip, useKeysBack } from "./controls";

/** Render the coloured dot of the machine's state, the text about a problem, and the details if they are open. */
export function MachineStatus() {
  const [open, setOpen] = useState(false);
  const dot = useRef<HTMLButtonElement>(null);
  /** Close the details, and return the focus of the keyboard from the details to the dot. */
  const close = () => {
    if (document.activeElement?.closest(".machine-details") != null) dot.current?.focus();
    setOpen(false);
  };
  const trouble = useApp(machineTrouble);
  const connected = useApp((state) => state.connection.status === "open");
  const state = !connected ? "lost" : trouble === null ? "well" : "slow";
  const words = !connected ? "No connection" : (trouble ?? "The machine keeps up");
  return (
    <>
      <Tip words={`${words}. Show or hide frame rate, latency and method.`}>
        <Button
          ref={dot}
          className="machine-dot"
          aria-label={`Details of the machine: ${words}`}
          aria-expanded={open}
          data-state={state}
          data-testid="machine"
          onPress={(event) => {
            giveKeysBack(event.pointerType);
            setOpen(!open);
          }}
        >
          <span aria-hidden="true" />
        </Button>
      </Tip>
      {trouble === null ? null : (
        <span className="warning-text" data-testid="machine-trouble">
          {trouble}
        </span>
      )}
      {open ? <MachineDetails onClose={close} /> : null}
    </>
  );
}

interface DetailsProps {
  onClose: () => void;
}

/** Render the machine's figures (rates and times). The panel takes no focus, so that the user can fly meanwhile. */
function MachineDetails({ onClose }: DetailsProps) {
  const { fps, ageMs } = useApp((state) => state.pace);
  const status = useApp((state) => state.status);
  const cluster = useApp((state) => state.cluster);
  const byCard = useApp((state) => state.frames[LEAD_VIEW]?.method.startsWith("gpu-") === true);
  const rows: readonly (readonly [term: string, value: string])[] = [
    ["Latency", ageMs === null ? "\u2013" : `${fixed(ageMs)} ms`],
    ...(byCard
      ? [["Rendered by", "graphics card"] as const]
      : status === null
        ? []
        : [["Processor", `${plural(status.threads, "core")}, ${simdText(status.simd)}`] as const]),
  ];
  return (
    <section className="machine-details numbers" aria-label="Details of the machine" data-testid="machine-details">
      <header>
        <h2>Details</h2>
        <Act kind="icon" icon="close" words="Close the details" onPress={onClose} />
      </header>
      <dl className="facts">
        <div>
          <dt>Frames</dt>
          <dd className="pace" title="Frame rate of the airway view during the last movement">
            {fps === null ? "\u2013" : `${fps}/s`} <TargetRate />
          </dd>
        </div>
        <ProcessorRow />
        {rows.map(([term, value]) => (
          <div key={term}>
            <dt>{term}</dt>
            <dd>{value}</dd>
          </div>
        ))}
        <div>
          <dt>Picture</dt>
          <dd>
            <FinenessText />
          </dd>
        </div>
        <div>
          <dt>Method</dt>
          <dd>
            <MethodText />
          </dd>
        </div>
        {cluster === null ? null : (
          <div>
            <dt>Cluster</dt>
            <dd className={needsLook(cluster) ? "warning-text" : undefined} data-testid="cluster">
              {clusterText(cluster)}
            </dd>
          </div>
        )}
      </dl>
      {cluster === null ? null : <ClusterDetails cluster={cluster} />}
    </section>
  );
}

const PROCESSORS = { auto: "Automatic", cpu: "Processor (CPU)", gpu: "Graphics card" } as const;

/** Render the choice of the processor that renders the airway view; nothing where there is no choice. */
function ProcessorRow() {
  const station = useStation();
  const keysBack = useKeysBack();
  const processor = useApp((state) => state.processor);
  if (processor === null || !processor.has_graphics) return null;
  const { choice, is_forced, problem } = processor;
  return (
    <div>
      <dt>Render by</dt>
      <dd>
        <Select
          aria-label="Processor of the airway view"
          className="select small"
          isDisabled={is_forced}
          selectedKey={choice}
          onOpenChange={keysBack.onOpenChange}
          onSelectionChange={(key) => {
            if (key === "auto" || key === "cpu" || key === "gpu") station.send({ type: "set_processor", choice: key });
          }}
        >
          <Tip
            words={
              is_forced
                ? "Chosen by the environment variable CARINA_BACKEND"
                : "Automatic uses the graphics card only where it was measured to be faster"
            }
          >
            <Button className="plain-text" onPressStart={keysBack.onPressStart}>
              <SelectValue>{() => PROCESSORS[choice]}</SelectValue>
            </Button>
          </Tip>
          <Popover className="popover" offset={4}>
            <ListBox className="listbox">
              {Object.entries(PROCESSORS).map(([key, words]) => (
                <ListBoxItem key={key} id={key} textValue={words} className="listbox-item">
                  {words}
                </ListBoxItem>
              ))}
            </ListBox>
          </Popover>
        </Select>
        {problem === null ? null : <p className="warning-text">{problem}</p>}
      </dd>
    </div>
  );
}

const RATES_HZ = [15, 30, 60] as const;

/** Render the selection of the target frame rate, beside the measured frame rate. */
const TargetRate = memo(function TargetRate() {
  const station = useStation();
  const keysBack = useKeysBack();
  const rate = useApp((state) => state.session?.frame_rate_hz ?? 60);
  const choices = RATES_HZ.some((known) => known === rate) ? RATES_HZ : [...RATES_HZ, rate];
  return (
    <Select
      aria-label="Target frame rate while moving"
      className="select small"
      selectedKey={String(rate)}
      onOpenChange={keysBack.onOpenChange}
      onSelectionChange={(key) => {
        if (key !== null && Number(key) !== rate) station.send({ type: "set_frame_rate", rate_hz: Number(key) });
      }}
    >
      <Tip words="Target frame rate while moving (lower = sharper)">
        <Button className="plain-text" onPressStart={keysBack.onPressStart}>
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
  return methodText(made, requested);
}

/** Render the resolution of the displayed airway picture, relative to the size of the view. */
function FinenessText() {
  const station = useStation();
  const frame = useApp((state) => state.frames[LEAD_VIEW] ?? null);
  const isSeen = useApp(isLeadShown);
  if (frame === null || !isSeen) return "airway view hidden";
  if (frame.stands_for !== null) return "viewfinder";
  const wanted = station.wall.find(LEAD_VIEW)?.wantedPixels?.width ?? frame.width;
  return (
    <span title="Resolution of the airway view: reduced while moving, full at rest">{finenessText(frame, wanted)}</span>
  );
}

const SIMD_TEXTS: Readonly<Record<string, string>> = {
  avx512: "AVX-512",
  avx2: "AVX2",
  neon: "NEON",
  portable: "portable",
};
const simdText = (name: string): string => SIMD_TEXTS[name] ?? name;
