/** Two sticks for two thumbs on a touch screen: the left one advances and rotates, the right one turns the view. */

import { useRef, useState } from "react";
import type { HoldAxis } from "../input/keymap";
import { deflectionOf } from "../input/stick";
import { useApp, useStation } from "./context";

/** Render the flight pad; the style sheet shows it only on a touch screen. */
export function FlightPad() {
  const watches = useApp((state) => state.watches);
  if (watches) return null;
  return (
    <>
      <Stick side="left" name="Advance and rotate" across="roll" along="advance" testId="stick-left" />
      <Stick side="right" name="Look around" across="yaw" along="pitch" testId="stick-right" />
    </>
  );
}

interface StickProps {
  side: "left" | "right";
  name: string;
  across: HoldAxis;
  along: HoldAxis;
  testId: string;
}

const REST = { right: 0, down: 0 } as const;

function Stick({ side, name, across, along, testId }: StickProps) {
  const station = useStation();
  const finger = useRef<number | null>(null);
  const [at, setAt] = useState<{ right: number; down: number }>(REST);
  const set = (deflection: { right: number; down: number }) => {
    setAt(deflection);
    station.flight.stick(across, deflection.right);
    // A thumb that moves up advances the tip, or bends the view up.
    station.flight.stick(along, -deflection.down);
  };
  const follow = (event: React.PointerEvent<HTMLDivElement>) => {
    const box = event.currentTarget.getBoundingClientRect();
    set(deflectionOf(event.clientX - box.left, event.clientY - box.top, box.width));
  };
  const end = (event: React.PointerEvent<HTMLDivElement>) => {
    if (event.pointerId !== finger.current) return;
    finger.current = null;
    set(REST);
  };
  return (
    // The keyboard moves the tip by its own keys; this element is for fingers alone.
    <div
      className={`stick ${side}`}
      data-testid={testId}
      aria-hidden="true"
      onPointerDown={(event) => {
        if (finger.current !== null) return;
        finger.current = event.pointerId;
        event.currentTarget.setPointerCapture(event.pointerId);
        follow(event);
      }}
      onPointerMove={(event) => {
        if (event.pointerId === finger.current) follow(event);
      }}
      onPointerUp={end}
      onPointerCancel={end}
      // A stick that the layout hides under a thumb gets no release of the pointer.
      onLostPointerCapture={end}
    >
      <span className="thumb" style={{ translate: `${at.right * 28}px ${at.down * 28}px` }} />
      <span className="stick-name">{name}</span>
    </div>
  );
}
