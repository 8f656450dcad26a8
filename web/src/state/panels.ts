/** Choice between the list and the panel of the step in the left column of a window that is too narrow for both. */

import type { Step } from "./steps";

/** A panel of the left column: the list (airways or history), or the panel of the step. */
export type PanelName = "list" | "step";

/** Properties of the interface's state from which the shown panel follows. */
interface PanelState {
  readonly panel: PanelName;
  readonly list: "airways" | "history";
  readonly step: Step;
  readonly devicesOpen: boolean;
  readonly keysOpen: boolean;
}

/** Return the panel that a step shows first: the tree in *Airways*, whose tools are beside it; else the step's panel. */
export const panelOf = (step: Step): PanelName => (step === "airways" ? "list" : "step");

/** Return the panel after a change of the interface: a chosen list, a changed step or an opened panel is shown. */
export function panelAfter(ui: PanelState, change: Partial<PanelState>): PanelName {
  if (change.panel !== undefined) return change.panel;
  if (change.list !== undefined) return "list";
  if (change.devicesOpen === true || change.keysOpen === true) return "step";
  if (change.step !== undefined && change.step !== ui.step) return panelOf(change.step);
  return ui.panel;
}

/** Return whether a change of the interface shows another panel, which opens the bottom sheet of a touch screen. */
export const opensPanel = (change: Partial<PanelState>): boolean =>
  change.panel !== undefined ||
  change.list !== undefined ||
  change.step !== undefined ||
  change.devicesOpen === true ||
  change.keysOpen === true;
