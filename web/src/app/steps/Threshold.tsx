/**
 * Threshold of air for the airway segmentation: a slider for the user's value, and a button that restores the automatic
 * value.
 */

import { useEffect, useState } from "react";
import { Label, Slider, SliderOutput, SliderThumb, SliderTrack } from "react-aria-components";
import { fixed } from "../../state/format";
import { useApp, useStation } from "../context";
import { Act } from "../controls";

/** Render the slider of the air threshold; nothing without an open case. */
export function Threshold() {
  const station = useStation();
  const value = useApp((state) => state.session?.lumen_threshold ?? null);
  const info = useApp((state) => state.session?.case ?? null);
  const [moving, setMoving] = useState<number | null>(null);
  // biome-ignore lint/correctness/useExhaustiveDependencies: a new value from the server replaces the dragged value
  useEffect(() => setMoving(null), [value]);
  if (info === null) return null;
  const [low, high] = info.is_hu ? [-1000, -500] : [info.value_range[0] ?? 0, info.value_range[1] ?? 1];
  const unit = info.is_hu ? " HU" : "";
  const shown = moving ?? value ?? (low + high) / 2;
  return (
    <div className="threshold">
      <Slider
        className="slider"
        minValue={low}
        maxValue={high}
        step={info.is_hu ? 5 : Math.max(Math.round((high - low) / 200), 1)}
        value={Math.min(Math.max(shown, low), high)}
        onChange={setMoving}
        onChangeEnd={(next) => station.send({ type: "set_lumen_threshold", value: next })}
      >
        <Label>Air threshold</Label>
        <SliderOutput className="numbers">
          {() => (value === null && moving === null ? "automatic" : `${fixed(shown)}${unit}`)}
        </SliderOutput>
        <SliderTrack className="slider-track">
          <SliderThumb className="slider-thumb" />
        </SliderTrack>
      </Slider>
      {value === null ? null : (
        <Act
          kind="quiet"
          label="Automatic"
          words="Segment the airways with a threshold derived from the volume"
          onPress={() => station.send({ type: "set_lumen_threshold", value: null })}
        />
      )}
    </div>
  );
}
