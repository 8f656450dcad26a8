/** Card that explains one element of the window: a hint of the first minute, or a stop of the tour. */

import { type CSSProperties, useEffect, useLayoutEffect, useRef, useState } from "react";
import { Button } from "react-aria-components";
import { type GuideStop, HINTS, hintsDue, TOUR } from "../state/guide";
import { type Box, cardPlace } from "../state/guide-place";
import { useApp, useStation } from "./context";
import { Act, giveKeysBack } from "./controls";

/** Interval, ms, between two measurements of the element that the card explains; the layout may move the element. */
const MEASURE_MS = 400;

/** Render the current hint or stop of the tour; nothing for a user who has read the hints. */
export function Guide() {
  const station = useStation();
  const tourAt = useApp((state) => state.ui.tourAt);
  const hintAt = useApp((state) => state.ui.hintAt);
  const due = useApp(hintsDue);
  if (tourAt !== null) {
    const at = TOUR[tourAt];
    return at === undefined ? null : (
      <Card
        key={`tour ${tourAt}`}
        stop={at}
        name={`Tour, ${tourAt + 1} of ${TOUR.length}`}
        takesFocus
        onBack={tourAt === 0 ? null : () => station.tourTo(tourAt - 1)}
        onNext={() => station.tourTo(tourAt + 1)}
        isLast={tourAt + 1 === TOUR.length}
        onLeave={() => station.tourTo(null)}
        leaveLabel="Leave the tour"
      />
    );
  }
  const hint = due ? HINTS[hintAt] : undefined;
  if (hint === undefined) return null;
  const isLast = hintAt + 1 === HINTS.length;
  const read = () => station.send({ type: "read_hints" });
  return (
    <Card
      key={`hint ${hintAt}`}
      stop={hint}
      name={`Hint ${hintAt + 1} of ${HINTS.length}`}
      takesFocus={false}
      onBack={null}
      onNext={() => (isLast ? read() : station.ui({ hintAt: hintAt + 1 }))}
      isLast={isLast}
      onTour={() => {
        read();
        station.tourTo(0);
      }}
      onLeave={read}
      leaveLabel="Close the hints"
    />
  );
}

interface CardProps {
  stop: GuideStop;
  name: string;
  /** Whether the card takes the keyboard focus; a hint leaves the keys to the flight. */
  takesFocus: boolean;
  onBack: (() => void) | null;
  onNext: () => void;
  isLast: boolean;
  onTour?: () => void;
  onLeave: () => void;
  leaveLabel: string;
}

function Card({ stop, name, takesFocus, onBack, onNext, isLast, onTour, onLeave, leaveLabel }: CardProps) {
  const card = useRef<HTMLElement>(null);
  const box = useAnchor(stop);
  useEffect(() => {
    if (takesFocus) card.current?.querySelector<HTMLElement>("[data-testid=guide-next]")?.focus();
  }, [takesFocus]);
  return (
    <>
      {box === null ? null : <div className="guide-ring" style={ringStyle(box)} aria-hidden="true" />}
      <section
        ref={card}
        className="guide-card"
        style={cardPlace(box, window.innerWidth, window.innerHeight)}
        aria-label={name}
        data-testid="guide"
      >
        <header>
          <span className="quiet">{name}</span>
          <Act kind="icon" icon="close" words={leaveLabel} testId="guide-leave" onPress={onLeave} />
        </header>
        <h2>{stop.title}</h2>
        <p>{stop.words}</p>
        <div className="row">
          {/* These buttons have no tooltip, which would cover the text of the card. */}
          <Button
            className="button primary"
            data-testid="guide-next"
            onPress={(event) => {
              if (!takesFocus) giveKeysBack(event.pointerType);
              onNext();
            }}
          >
            {isLast ? "Done" : "Next"}
          </Button>
          {onBack === null ? null : (
            <Button className="button" onPress={onBack}>
              Back
            </Button>
          )}
          {onTour === undefined ? null : (
            <Act kind="quiet" label="Two-minute tour" words="Explain the window" testId="start-tour" onPress={onTour} />
          )}
        </div>
      </section>
    </>
  );
}

/** Return the box of the element that a stop of the tour points at; null while no such element is visible. */
function useAnchor(stop: GuideStop): Box | null {
  const [box, setBox] = useState<Box | null>(null);
  useLayoutEffect(() => {
    const measure = () => setBox((old) => sameOr(old, boxOf(stop)));
    measure();
    const timer = setInterval(measure, MEASURE_MS);
    window.addEventListener("resize", measure);
    return () => {
      clearInterval(timer);
      window.removeEventListener("resize", measure);
    };
  }, [stop]);
  return box;
}

function boxOf(stop: GuideStop): Box | null {
  for (const selector of stop.anchors) {
    const element = document.querySelector(selector);
    const found = element?.getBoundingClientRect();
    const isShown = found !== undefined && found.width > 0 && found.bottom > 0 && found.top < window.innerHeight;
    if (isShown) return { left: found.left, top: found.top, width: found.width, height: found.height };
  }
  return null;
}

const sameOr = (old: Box | null, now: Box | null): Box | null =>
  old !== null && now !== null && (["left", "top", "width", "height"] as const).every((side) => old[side] === now[side])
    ? old
    : now;

const ringStyle = ({ left, top, width, height }: Box): CSSProperties => ({
  left: left - 3,
  top: top - 3,
  width: width + 6,
  height: height + 6,
});
