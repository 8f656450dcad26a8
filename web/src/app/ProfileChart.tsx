/**
 * Chart of the lumen diameter along a branch: a line with an error band, grey sections at forks, and the values under
 * the cursor as text.
 */

import { type PointerEvent, useState } from "react";
import { fixed, mm } from "../state/format";
import { chartScale, nearestSection, type ProfilePoint, runsOf } from "../state/profile";

/** Width of the chart, px. */
const WIDTH = 216;
/** Height of the chart, px. */
const HEIGHT = 92;
/** Space for the diameters at the left of the chart, px. */
const LEFT = 24;
/** Space for the distances below the chart, px. */
const BELOW = 14;
/** Space above the chart, px. */
const ABOVE = 5;
/** Space at the right of the chart, px. */
const RIGHT = 4;

interface ProfileChartProps {
  points: readonly ProfilePoint[];
  title: string;
  /** Text that is shown below the chart while the cursor is outside the chart. */
  words: string;
}

/** Render the chart of the lumen diameter along a branch. */
export function ProfileChart({ points, title, words }: ProfileChartProps) {
  const [at, setAt] = useState<ProfilePoint | null>(null);
  if (points.length < 2) return <p className="empty">Too short for a lumen profile.</p>;
  const inside = { width: WIDTH - LEFT - RIGHT, height: HEIGHT - BELOW - ABOVE };
  const scale = chartScale(points, inside.width, inside.height);
  const x = (mmAlong: number) => LEFT + scale.x(mmAlong);
  const y = (lumen: number) => ABOVE + scale.y(lumen);
  const hover = (event: PointerEvent<SVGSVGElement>) => {
    const box = event.currentTarget.getBoundingClientRect();
    const column = ((event.clientX - box.x) / box.width) * WIDTH - LEFT;
    setAt(nearestSection(points, (column / inside.width) * scale.lengthMm));
  };
  return (
    <figure className="profile" data-testid="profile">
      <svg
        viewBox={`0 0 ${WIDTH} ${HEIGHT}`}
        role="img"
        aria-label={`${title}: ${rangeText(points)}`}
        onPointerMove={hover}
        onPointerLeave={() => setAt(null)}
      >
        {scale.ticksMm.map((tick) => (
          <g key={tick}>
            <line className="grid" x1={LEFT} x2={WIDTH - RIGHT} y1={y(tick)} y2={y(tick)} />
            <text x={LEFT - 4} y={y(tick) + 3} textAnchor="end">
              {fixed(tick, Number.isInteger(tick) ? 0 : 1)}
            </text>
          </g>
        ))}
        {runsOf(points).map((run) => (
          <g key={run[0]?.atMm}>
            <path className="band" d={bandOf(run, x, y)} />
            <path className="line" d={lineOf(run, x, y)} />
          </g>
        ))}
        {points
          .filter((point) => point.atJunction)
          .map((point) => (
            <circle key={point.atMm} className="junction" cx={x(point.atMm)} cy={y(point.lumenMm)} r={1.6} />
          ))}
        <text x={LEFT} y={HEIGHT - 3}>
          0
        </text>
        <text x={WIDTH - RIGHT} y={HEIGHT - 3} textAnchor="end">
          {mm(scale.lengthMm, 0)}
        </text>
        {at === null ? null : (
          <>
            <line className="at" x1={x(at.atMm)} x2={x(at.atMm)} y1={ABOVE} y2={HEIGHT - BELOW} />
            <circle className="at" cx={x(at.atMm)} cy={y(at.lumenMm)} r={2.5} />
          </>
        )}
      </svg>
      <figcaption className="quiet small numbers">{at === null ? words : pointText(at)}</figcaption>
    </figure>
  );
}

function pointText(point: ProfilePoint): string {
  const lumen = point.errorMm === null ? mm(point.lumenMm) : `${fixed(point.lumenMm, 1)} \u00b1 ${mm(point.errorMm)}`;
  return `at ${mm(point.atMm, 0)}: ${lumen}${point.atJunction ? ", at a fork" : ""}`;
}

function rangeText(points: readonly ProfilePoint[]): string {
  const widths = points.filter((point) => !point.atJunction).map((point) => point.lumenMm);
  return widths.length === 0
    ? "not measured within forks"
    : `from ${mm(Math.min(...widths))} to ${mm(Math.max(...widths))}`;
}

type Axis = (value: number) => number;

const lineOf = (run: readonly ProfilePoint[], x: Axis, y: Axis): string =>
  run.map((point, n) => `${n === 0 ? "M" : "L"}${x(point.atMm).toFixed(1)} ${y(point.lumenMm).toFixed(1)}`).join("");

function bandOf(run: readonly ProfilePoint[], x: Axis, y: Axis): string {
  const edge = (sign: 1 | -1) =>
    run.map(
      (point) =>
        `${x(point.atMm).toFixed(1)} ${y(Math.max(point.lumenMm + sign * (point.errorMm ?? 0), 0)).toFixed(1)}`,
    );
  return `M${edge(1).join("L")}L${edge(-1).reverse().join("L")}Z`;
}
