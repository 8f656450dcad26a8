/** Map of the airways and timeline of the score screen. */

import { clock } from "../state/playing";
import { mapBox, mapLines, replayMarks, spread, timeColour, visitText } from "../state/score-map";
import type { FlightScore, TimelineMark } from "../wire/messages";
import { useApp, useStation } from "./context";

/** Render the airways from the front; each segment has the colour of the time at which it was seen. */
export function ScoreMap({ score }: { score: FlightScore }) {
  const tree = useApp((state) => state.tree);
  if (tree === null || score.segments.length === 0) return null;
  const lines = mapLines(score, tree);
  const named = score.segments.map((one) => visitText(one, clock)).join("; ");
  return (
    <figure className="score-map" data-testid="score-map">
      <svg viewBox={mapBox(lines).join(" ")} role="img" aria-label={`Map of the airways. ${named}`}>
        {lines.map(({ id, points, segment, at }) => (
          <polyline
            key={id}
            points={points.map(({ x, y }) => `${x.toFixed(1)},${y.toFixed(1)}`).join(" ")}
            className="map-line"
            data-how={segment === null ? "way" : at === null ? "not" : segment.entered ? "entered" : "outside"}
            style={at === null ? undefined : { stroke: timeColour(at) }}
          >
            {segment === null ? null : <title>{visitText(segment, clock)}</title>}
          </polyline>
        ))}
      </svg>
      <figcaption className="quiet">
        Blue early, orange late; thick: entered, thin: from outside, grey: not seen
      </figcaption>
    </figure>
  );
}

const MARK_WORDS: Readonly<Record<TimelineMark["kind"], string>> = {
  seen: "seen",
  contact: "wall contact",
  wrong: "wrong branch or segment",
  revisit: "visited again",
};

/** Minimum distance between two buttons of the timeline, as a share of its length. */
const MOMENT_SHARE = 0.07;

/** Render the timeline of the procedure with its events, and buttons at the worst moments. */
export function Timeline({ score }: { score: FlightScore }) {
  const station = useStation();
  const { clock_start_s: startS, clock_end_s: endS } = score;
  const share = (atS: number) => Math.min(Math.max((atS - startS) / Math.max(endS - startS, 1e-6), 0), 1);
  const replays = replayMarks(score);
  const places = spread(
    replays.map(({ time_s }) => share(time_s)),
    MOMENT_SHARE,
  );
  return (
    <figure className="timeline" data-testid="timeline" aria-label="Timeline of the flight">
      <div className="timeline-bar">
        {score.timeline.map(({ at_s: atS, kind, name }) => (
          <span
            key={`${atS} ${kind} ${name}`}
            className="timeline-mark"
            data-kind={kind}
            style={{ left: `${100 * share(atS)}%` }}
            title={`${clock(atS)} ${MARK_WORDS[kind]}: ${name}`}
          />
        ))}
        {replays.map(({ time_s, words, label, isHighError }, n) => (
          <button
            key={label}
            type="button"
            className="timeline-moment"
            data-testid={isHighError ? "high-error-moment" : undefined}
            style={{ left: `${100 * (places[n] ?? 0)}%` }}
            title={`${clock(time_s)} ${words}`}
            aria-label={`${label}: replay from 3 s before ${clock(time_s)}: ${words}`}
            onClick={() => station.replayMoment(score.flight, time_s)}
          >
            {label}
          </button>
        ))}
      </div>
      <figcaption className="quiet numbers">
        <span>0:00</span>
        <span>
          {score.comparison_moments.length === 0
            ? "above: seen; below: contacts, wrong branches; numbers: replay"
            : "above: seen; below: faults; replay: numbers, letters (high-error events)"}
        </span>
        <span>{clock(endS - startS)}</span>
      </figcaption>
    </figure>
  );
}
