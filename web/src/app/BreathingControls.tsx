/** Simulated breathing: its switch, movement and period, the button for a cough, and the words in the picture. */

import { useEffect, useRef, useState } from "react";
import {
  Button,
  Dialog,
  DialogTrigger,
  Label,
  Popover,
  Slider,
  SliderOutput,
  SliderThumb,
  SliderTrack,
} from "react-aria-components";
import { fixed } from "../state/format";
import { attemptOf } from "../state/training";
import type { BreathingInfo } from "../wire/messages";
import { LEAD_VIEW } from "../wire/views";
import { useApp, useStation } from "./context";
import { Act, IconLabel, SwitchKey, Tip, useKeysBack } from "./controls";
import { Icon } from "./icons";

/** Published values of quiet breathing, which the server also uses by default. */
const QUIET: BreathingInfo = { on: false, movement_mm: 12, period_s: 3.6 };

/**
 * Return a function that notes that the breathing was switched on in the step Train. When the user leaves the step, such a
 * breathing ends, unless an attempt runs, whose end also ends its breathing. A breathing that was switched on above the
 * airway view goes on.
 */
export function useBreathingOfStep(): (on: boolean) => void {
  const station = useStation();
  const breathing = useApp((state) => state.session?.breathing ?? QUIET);
  const runs = useApp((state) => attemptOf(state) !== null);
  const latest = useRef({ breathing, runs, ofStep: false });
  Object.assign(latest.current, { breathing, runs });
  useEffect(
    () => () => {
      const { breathing, runs, ofStep } = latest.current;
      if (ofStep && breathing.on && !runs) station.send({ type: "set_breathing", ...breathing, on: false });
    },
    [station],
  );
  return (on) => {
    latest.current.ofStep = on;
  };
}

/** Render the switch of the breathing, and its settings while it is on; `switched` is called by the switch. */
export function BreathingControls({ switched }: { switched?: (on: boolean) => void }) {
  const station = useStation();
  const breathing = useApp((state) => state.session?.breathing ?? QUIET);
  const ready = useApp((state) => state.session?.airways === "found");
  const set = (part: Partial<BreathingInfo>) => station.send({ type: "set_breathing", ...breathing, ...part });
  return (
    <div className="breathing" data-testid="breathing">
      <div className="row">
        <SwitchKey
          label="Simulate breathing"
          words={
            breathing.on
              ? "Stop the simulated breathing"
              : "Simulate breathing in the airway view: picture, wall and contacts move. The slices show the CT."
          }
          on={breathing.on}
          disabled={!ready}
          testId="breathing-switch"
          onChange={() => {
            set({ on: !breathing.on });
            switched?.(!breathing.on);
          }}
        />
        {breathing.on ? (
          <Act
            label="Cough"
            words="Let the patient cough once: the airways narrow for half a second"
            testId="cough"
            onPress={() => station.send({ type: "cough" })}
          />
        ) : null}
      </div>
      {breathing.on ? (
        <>
          <Setting
            label="Movement of the lung bases"
            value={breathing.movement_mm}
            range={[0, 40, 1]}
            text={(mm) => `${fixed(mm)}\u202fmm`}
            onChange={(movement_mm) => set({ movement_mm })}
          />
          <Setting
            label="One breath"
            value={breathing.period_s}
            range={[1, 20, 0.1]}
            text={(s) => `${fixed(s, 1)}\u202fs`}
            onChange={(period_s) => set({ period_s })}
          />
        </>
      ) : null}
    </div>
  );
}

interface SettingProps {
  label: string;
  value: number;
  /** Least value, largest value and step. */
  range: readonly [number, number, number];
  text: (value: number) => string;
  onChange: (value: number) => void;
}

/** Render the slider of a number, which is sent when it is released. */
function Setting({ label, value, range, text, onChange }: SettingProps) {
  const [moving, setMoving] = useState<number | null>(null);
  // biome-ignore lint/correctness/useExhaustiveDependencies: a new value from the server replaces the dragged value
  useEffect(() => setMoving(null), [value]);
  const [least, most, step] = range;
  const shown = moving ?? value;
  return (
    <Slider
      className="slider"
      minValue={least}
      maxValue={most}
      step={step}
      value={shown}
      onChange={setMoving}
      onChangeEnd={onChange}
    >
      <Label>{label}</Label>
      <SliderOutput className="numbers">{() => text(shown)}</SliderOutput>
      <SliderTrack className="slider-track">
        <SliderThumb className="slider-thumb" />
      </SliderTrack>
    </Slider>
  );
}

/** Render the button above the airway view that opens the settings of the breathing. */
export function BreathingMenu() {
  const on = useApp((state) => state.session?.breathing?.on ?? false);
  const keysBack = useKeysBack();
  const words = on ? "Simulated breathing: on" : "Simulated breathing: off";
  return (
    <DialogTrigger onOpenChange={keysBack.onOpenChange}>
      <Tip words={words}>
        <Button
          className="button icon toggle label-if-wide"
          data-selected={on ? "true" : undefined}
          aria-label={words}
          onPressStart={keysBack.onPressStart}
          data-testid="breathing-menu"
        >
          <Icon name="breathing" />
          <IconLabel text="Breathing" />
        </Button>
      </Tip>
      <Popover className="popover breathing-menu" placement="bottom end" offset={4}>
        <Dialog aria-label="Simulated breathing">
          <BreathingControls />
        </Dialog>
      </Popover>
    </DialogTrigger>
  );
}

/** Render the words that every picture of a breathing patient contains; nothing over other pictures. */
export function BreathingLabel() {
  const breathes = useApp((state) => state.frames[LEAD_VIEW]?.breathes ?? false);
  if (!breathes) return null;
  return (
    <p className="breathing-label" role="status" data-testid="breathing-label">
      simulated breathing
    </p>
  );
}
