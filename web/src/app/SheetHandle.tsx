/** Handle of the bottom sheet, which replaces the left column on a touch screen and in a narrow window. */

import { useRef } from "react";
import { Button } from "react-aria-components";
import { trainingLayout } from "../state/training";
import { useApp, useStation } from "./context";
import { Icon } from "./icons";
import { panelTitle } from "./ListHead";

/** Vertical movement, px, from which a drag of the handle opens or closes the sheet. */
const SWIPE_PX = 24;

/** Render the handle; a press or a swipe opens or closes the sheet. */
export function SheetHandle() {
  const station = useStation();
  const open = useApp((state) => state.ui.sheetOpen);
  const title = useApp((state) =>
    state.ui.panel === "step" || trainingLayout(state) !== undefined
      ? panelTitle(state)
      : state.ui.list === "history"
        ? "History"
        : "Airways",
  );
  const fromY = useRef<number | null>(null);
  const swiped = useRef(false);
  return (
    <Button
      className="sheet-handle"
      aria-expanded={open}
      aria-label={open ? `Hide the panel ${title}` : `Show the panel ${title}`}
      data-testid="sheet-handle"
      onPointerDown={(event) => {
        fromY.current = event.clientY;
        swiped.current = false;
      }}
      onPointerUp={(event) => {
        const movedPx = fromY.current === null ? 0 : event.clientY - fromY.current;
        fromY.current = null;
        if (Math.abs(movedPx) < SWIPE_PX) return;
        swiped.current = true;
        station.ui({ sheetOpen: movedPx < 0 });
      }}
      onPress={() => {
        if (!swiped.current) station.ui({ sheetOpen: !station.state.ui.sheetOpen });
      }}
    >
      <span className="grip" aria-hidden="true" />
      <span>{title}</span>
      <Icon name={open ? "down" : "up"} />
    </Button>
  );
}
