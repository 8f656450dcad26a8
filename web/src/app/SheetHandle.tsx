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
  const swiped = useRef(false);
  return (
    <Button
      className="sheet-handle"
      aria-expanded={open}
      aria-label={open ? `Hide the panel ${title}` : `Show the panel ${title}`}
      data-testid="sheet-handle"
      onPointerDown={(event) => {
        const fromY = event.clientY;
        swiped.current = false;
        // The button releases the capture of the pointer, so the element under the finger gets the end of the swipe.
        const end = new AbortController();
        const { signal } = end;
        window.addEventListener(
          "pointerup",
          ({ clientY }) => {
            end.abort();
            if (Math.abs(clientY - fromY) < SWIPE_PX) return;
            swiped.current = true;
            station.ui({ sheetOpen: clientY < fromY });
          },
          { signal, capture: true },
        );
        window.addEventListener("pointercancel", () => end.abort(), { signal });
      }}
      onPress={({ pointerType }) => {
        if (pointerType === "keyboard" || !swiped.current) station.ui({ sheetOpen: !station.state.ui.sheetOpen });
      }}
    >
      <span className="grip" aria-hidden="true" />
      <span>{title}</span>
      <Icon name={open ? "down" : "up"} />
    </Button>
  );
}
