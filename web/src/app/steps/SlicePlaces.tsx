/** Picture of the slice positions of a CT whose slices were corrected at opening. */

import { sliceTicks } from "../../state/slice-ticks";
import type { CaseInfo } from "../../wire/messages";

const WIDTH = 288;
const HEIGHT = 46;
const TOP = 4;
const BASE = 26;

/** Render the slices of the files as lines, and the interpolated slices as marks; nothing without a correction. */
export function SlicePlaces({ info }: { info: CaseInfo }) {
  const count = info.shape_zyx[0] ?? 0;
  if (info.slice_places.length === 0 || count < 2) return null;
  const ticks = sliceTicks(info, WIDTH);
  const lean = ticks.leanPx;
  const words = [
    `${info.slice_places.length} slices of the files`,
    info.interpolated_slices.length === 0 ? "" : `${info.interpolated_slices.length} interpolated`,
    info.tilt_deg === null ? "" : `tilted by ${info.tilt_deg.toFixed(1)} degrees`,
  ].filter((text) => text !== "");
  return (
    <figure className="slice-places" data-testid="slice-places">
      <svg viewBox={`0 0 ${WIDTH} ${HEIGHT}`} role="img" aria-label={`Positions of the slices: ${words.join(", ")}`}>
        <path
          className="measured"
          d={ticks.measuredPx
            .map((x) => `M${(x - lean / 2).toFixed(1)} ${BASE}l${lean.toFixed(1)} ${TOP - BASE}`)
            .join("")}
        />
        {ticks.interpolatedPx.map(({ x, width, slice }) => (
          <rect key={slice} className="interpolated" x={x} y={BASE + 3} width={width} height={6}>
            <title>{`slice ${slice + 1}`}</title>
          </rect>
        ))}
        <text x={0} y={HEIGHT - 1}>
          slice 1
        </text>
        <text x={WIDTH} y={HEIGHT - 1} textAnchor="end">
          slice {count}
        </text>
      </svg>
      <figcaption className="quiet">
        Lines: {words[0]}
        {info.interpolated_slices.length === 0 ? "" : ". Marks: interpolated slices"}
        {info.tilt_deg === null ? "" : ". Leaning lines: gantry tilt"}.
      </figcaption>
    </figure>
  );
}
