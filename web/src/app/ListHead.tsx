/** Tabs of the left column: the airways, the history and, in a window without space for both, the panel of the step. */

import type { ReactNode } from "react";
import { Button } from "react-aria-components";
import { keyOf } from "../input/keymap";
import type { AppState } from "../state/app-state";
import { STEP_TEXTS } from "../state/steps";
import { trainingLayout } from "../state/training";
import { useApp, useStation } from "./context";
import { Tip } from "./controls";

const LISTS = [
  { list: "airways", title: "Airways", words: "The branches of the airway tree" },
  { list: "history", title: "History", words: "Edit history: return to any step" },
] as const;

/** Return the title of the panel that the left column shows beside the lists. */
export function panelTitle(state: AppState): string {
  const { ui, watches } = state;
  if (watches) return "View";
  if (trainingLayout(state) !== undefined) return STEP_TEXTS.train.title;
  if (ui.devicesOpen) return "Devices";
  if (ui.keysOpen) return "Key frames";
  // The list has the title of the step *Airways*; the panel of this step contains the tools that edit the tree.
  return ui.step === "airways" ? "Edit" : STEP_TEXTS[ui.step].title;
}

/** Render the head of the list in the left column; `children` are its further buttons. */
export function ListHead({ children }: { children?: ReactNode }) {
  return (
    <h2 className="list-head">
      <Tabs place="list" />
      {children}
    </h2>
  );
}

/** Render the tabs of a part of the left column: of the list, or of the panel of the step. */
export function Tabs({ place }: { place: "list" | "panel" }) {
  const station = useStation();
  const list = useApp((state) => state.ui.list);
  const title = useApp(panelTitle);
  return (
    <>
      {LISTS.map((one) => (
        <Tip key={one.list} words={one.words} keys={one.list === "history" ? keyOf("history") : undefined}>
          <Button
            className="list-choice"
            aria-label={`${one.title} list`}
            aria-pressed={place === "list" && one.list === list}
            data-testid={`${place}-${one.list}`}
            onPress={() => station.ui({ list: one.list })}
          >
            {one.title}
          </Button>
        </Tip>
      ))}
      <Tip words="The panel of this step">
        <Button
          className="list-choice panel-choice"
          aria-label={`${title} panel`}
          aria-pressed={place === "panel"}
          data-testid={`${place}-step`}
          onPress={() => station.ui({ panel: "step" })}
        >
          {title}
        </Button>
      </Tip>
    </>
  );
}
