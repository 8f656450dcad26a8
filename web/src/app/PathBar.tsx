/** Ruler of the route: the position of the tip, the forks, and the names and generations of the branches. */

import { useLayoutEffect, useRef, useState } from "react";
import { Slider, SliderThumb, SliderTrack } from "react-aria-components";
import { keyOf, keyOfHold } from "../input/keymap";
import { pathMm, tipLps } from "../state/app-state";
import { kindText } from "../state/branch-text";
import { fixed, mm } from "../state/format";
import { crossingsOf, crossingText, sliderLabel } from "../state/path-search";
import { isFromCarina, nearestMm, originText, pastMm, pathAtMm, scaleMm, sideText } from "../state/route";
import { AUTO_SPEEDS_MM_S } from "../state/speed";
import type { RouteInfo } from "../wire/messages";
import { useApp, useStation } from "./context";
import { Act } from "./controls";
import { Figure } from "./Figure";

/** Estimated width of a letter in the branch names, px; slightly too large, so that only names that fit are shown. */
const LETTER_PX = 6.6;

/** Render the ruler of the route, or a text if there is no route. */
export function PathBar() {
  const station = useStation();
  const route = useApp((state) => state.route);
  const stage = useApp((state) => state.session?.airways ?? "none");
  const watches = useApp((state) => state.watches);
  if (route === null) {
    return (
      <section className="path-bar" aria-label="Ruler of the route">
        <p className="empty">
          {stage === "found"
            ? "No route yet. Choose a branch in the list, or mark a target (N, then click in a slice). The route to it appears here."
            : "The route appears here once the airways have been segmented, or a path was found without them (Target)."}
        </p>
      </section>
    );
  }
  // Each element that follows the tip is a separate component, so that a new pose does not render the whole ruler
  // again.
  return (
    <section className="path-bar" aria-label="Ruler of the route" inert={watches}>
      <Act
        kind="icon"
        icon="previousFork"
        words="Back to the previous fork"
        keys={keyOf("previous_fork")}
        onPress={() => station.toFork("previous")}
      />
      <Withdraw />
      <Ruler route={route} />
      <Advance lengthMm={route.length_mm} />
      <Act
        kind="icon"
        icon="nextFork"
        words="Go to the next fork (Space flies there)"
        onPress={() => station.toFork("next")}
      />
      <AutoSpeed />
      <PathNumbers route={route} />
    </section>
  );
}

function Withdraw() {
  const station = useStation();
  const disabled = useApp((state) => (pathMm(state) ?? 0) <= 0);
  return (
    <Act
      kind="icon"
      icon="back"
      words="Withdraw 2 mm"
      keys={keyOfHold("advance", -1)}
      disabled={disabled}
      onPress={() => station.stepAlong(-1)}
    />
  );
}

function Advance({ lengthMm }: { lengthMm: number }) {
  const station = useStation();
  const disabled = useApp((state) => (pathMm(state) ?? lengthMm) >= lengthMm);
  return (
    <Act
      kind="icon"
      icon="forward"
      words="Advance 2 mm"
      keys={keyOfHold("advance", 1)}
      disabled={disabled}
      onPress={() => station.stepAlong(1)}
    />
  );
}

function AutoSpeed() {
  const station = useStation();
  const speed = useApp((state) => state.ui.autoSpeedMmS);
  return (
    <Figure
      label="Auto-flight speed"
      quiet
      words="Auto-flight speed (Space). Hold Shift to move slowly."
      unit="mm/s"
      value={speed}
      choices={AUTO_SPEEDS_MM_S}
      testId="auto-speed"
      onChange={(chosen) => (chosen === null ? undefined : station.ui({ autoSpeedMmS: chosen }))}
    />
  );
}

/** Render the positions of the tip and of the route's end, measured from the same origin as in the plan. */
function PathNumbers({ route }: { route: RouteInfo }) {
  const at = useApp(pathMm);
  const end = pastMm(route, route.length_mm);
  return (
    <p
      className="path-numbers numbers"
      data-testid="path-numbers"
      title={`Distances are measured from ${originText(route)}. The route is ${mm(route.length_mm, 0)} long from its start.`}
    >
      {at === null ? "off the path" : <strong>{mm(Math.abs(pastMm(route, at)))}</strong>}
      <span className="quiet">
        {at === null ? originText(route) : sideText(route, at)}, end {mm(end, 0)}
      </span>
    </p>
  );
}

const percentOf =
  (lengthMm: number) =>
  (value: number): string =>
    `${(100 * Math.min(Math.max(value / lengthMm, 0), 1)).toFixed(3)}%`;

function Ruler({ route }: { route: RouteInfo }) {
  const box = useRef<HTMLDivElement>(null);
  const [width, setWidth] = useState(0);
  useLayoutEffect(() => {
    const element = box.current;
    if (element === null) return;
    const observer = new ResizeObserver(() => setWidth(element.clientWidth));
    observer.observe(element);
    return () => observer.disconnect();
  }, []);
  const length = Math.max(route.length_mm, 0.1);
  const percent = percentOf(length);
  return (
    <div className="ruler" ref={box}>
      <RulerSpans route={route} width={width} />
      <RulerSlider route={route} />
      <div className="ruler-scale numbers" aria-hidden="true">
        {marks(route, length, width).map((past) => (
          <span
            key={past}
            className={past === 0 ? "origin" : undefined}
            style={{ left: percent(pathAtMm(route, past)) }}
          >
            {past === 0 && isFromCarina(route) ? "carina" : fixed(past)}
          </span>
        ))}
      </div>
    </div>
  );
}

function RulerSpans({ route, width }: { route: RouteInfo; width: number }) {
  const here = useApp((state) => {
    const at = pathMm(state);
    return at === null ? -1 : route.spans.findIndex((span) => at >= span.from_mm && at < span.to_mm);
  });
  const length = Math.max(route.length_mm, 0.1);
  const percent = percentOf(length);
  return (
    <div className="ruler-spans" aria-hidden="true">
      {route.spans.map((span, n) => {
        const pixels = ((span.to_mm - span.from_mm) / length) * width;
        const kind = kindText(span.kind);
        const name = kind ?? span.name ?? "";
        const generation = String(span.generation);
        const full = name === "" ? `generation ${generation}` : `${name} \u00b7 ${generation}`;
        const words = [full, name, generation].find((text) => text !== "" && text.length * LETTER_PX + 8 <= pixels);
        return (
          <span
            key={span.branch_id}
            className={`span${kind === null ? "" : " drawn"}${n === here ? " here" : ""}`}
            style={{ left: percent(span.from_mm), width: percent(span.to_mm - span.from_mm) }}
          >
            {route.lumen_known || kind !== null ? (words ?? "") : ""}
          </span>
        );
      })}
    </div>
  );
}

function RulerSlider({ route }: { route: RouteInfo }) {
  const station = useStation();
  const at = useApp(pathMm);
  const crossings = useApp((state) => crossingsOf(route.target_id, state.session?.targets ?? []));
  const length = Math.max(route.length_mm, 0.1);
  const percent = percentOf(length);
  return (
    <Slider
      className={at === null ? "path-slider off" : "path-slider"}
      aria-label={sliderLabel(route, crossings.length)}
      minValue={pastMm(route, 0)}
      maxValue={pastMm(route, length)}
      step={0.1}
      value={pastMm(route, at ?? 0)}
      onChange={(value) => station.goTo(pathAtMm(route, value))}
    >
      <SliderTrack className="path-track">
        <div className="path-line" />
        <div className="path-done" style={{ width: percent(at ?? 0) }} />
        {route.spans
          .filter((span) => span.kind !== "tracked")
          .map((span) => (
            <span
              key={span.branch_id}
              className="path-drawn"
              style={{ left: percent(span.from_mm), width: percent(span.to_mm - span.from_mm) }}
            />
          ))}
        {route.forks_mm.map((fork) => (
          <span key={fork} className="fork" style={{ left: percent(fork) }} />
        ))}
        {crossings.map((along) => (
          <span
            key={along}
            className="wall-crossing"
            data-testid="wall-crossing"
            title={crossingText(route, along)}
            style={{ left: percent(along) }}
          />
        ))}
        {at === null ? <Shadow route={route} percent={percent} /> : null}
        <span className="flag" />
        <SliderThumb className="path-thumb" />
      </SliderTrack>
    </Slider>
  );
}

/** Render a mark on the ruler at the route position that is nearest to a freely moving tip. */
function Shadow({ route, percent }: { route: RouteInfo; percent: (value: number) => string }) {
  const tip = useApp((state) => (state.pose === null ? null : tipKey(tipLps(state))));
  if (tip === null) return null;
  return <span className="shadow" style={{ left: percent(nearestMm(route, tip)) }} />;
}

let lastTip: readonly [number, number, number] | null = null;

/**
 * Return the previous array if the position is equal to it, because a selector must return the same object for the same
 * value.
 */
function tipKey(tip: readonly [number, number, number] | null): readonly [number, number, number] | null {
  if (tip !== null && lastTip !== null && tip.every((value, index) => value === lastTip?.[index])) return lastTip;
  lastTip = tip;
  return tip;
}

/** Return the labelled distances of the ruler, mm from the origin, far enough apart that the labels do not overlap. */
function marks(route: RouteInfo, lengthMm: number, widthPx: number): number[] {
  if (widthPx < 50) return [];
  const step = [5, 10, 20, 25, 50, 100, 200].find((value) => (value / lengthMm) * widthPx >= 44) ?? 500;
  return scaleMm(route, lengthMm, step);
}
