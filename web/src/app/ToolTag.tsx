/**
 * Indicators of the active tool: in every view, at the list of branches, and in the line at the bottom of the window.
 */

import { Button } from "react-aria-components";
import { marksByPen, penMarkText } from "../state/pen";
import { type Armed, shortOf, takesAway, textsOf, wantsBranch, worksIn } from "../state/tools";
import { INK } from "../views/ink";
import type { ViewName } from "../wire/messages";
import { useApp, useStation } from "./context";
import { Icon, type IconName, outlineOfIcon } from "./icons";

/** Icon of each tool. */
export const TOOL_ICONS: Readonly<Record<Armed, IconName>> = {
  target: "target",
  root: "target",
  start: "root",
  "lesion-add": "paint",
  "lesion-cut": "erase",
  add: "addBranch",
  bridge: "bridge",
  cut: "cut",
  fork: "fork",
  smooth: "smooth",
  paint: "paint",
  erase: "erase",
  reroot: "root",
};

/**
 * Render the effect of a click with the active tool in the corner of a view. The indicator is a button that deactivates
 * the tool, because a touch screen has no Escape key.
 */
export function ToolTag({ view }: { view: ViewName }) {
  const armed = useApp((state) => state.ui.armed);
  if (armed === null) return null;
  return <Tag armed={armed} works={worksIn(armed, view)} where="picture" />;
}

/** Render the indicator of the active tool at the list of branches, if a click on a row applies the tool. */
export function ListToolTag() {
  const armed = useApp((state) => (wantsBranch(state.ui.armed, state.ui.forkHeld !== null) ? state.ui.armed : null));
  return armed === null ? null : <Tag armed={armed} works where="list" />;
}

function Tag({ armed, works, where }: { armed: Armed; works: boolean; where: "picture" | "list" }) {
  const station = useStation();
  const { label } = textsOf(armed, false);
  return (
    <Button
      className={where === "picture" ? "tool-tag corner" : "tool-tag"}
      data-testid="tool-tag"
      data-works={works}
      data-takes={takesAway(armed) || undefined}
      aria-label={`${shortOf(armed)}${works ? "" : " not in this view"}: cancel ${label} (Esc)`}
      excludeFromTabOrder
      onPress={() => station.disarm()}
    >
      <Icon name={TOOL_ICONS[armed]} />
      {works ? shortOf(armed) : <s>{shortOf(armed)}</s>}
      {works ? null : <span className="why">not in this view</span>}
      <Icon name="close" />
    </Button>
  );
}

/**
 * Render the instruction of the active tool and the key that deactivates it at the bottom of the window, also below an
 * enlarged view.
 */
export function ToolHint() {
  const armed = useApp((state) => state.ui.armed);
  const forkHeld = useApp((state) => state.ui.forkHeld !== null);
  const pen = useApp((state) => state.pen);
  if (armed === null) return null;
  const { label, hint } = textsOf(armed, forkHeld);
  const words = pen !== null && marksByPen(armed) ? penMarkText(pen) : hint;
  return (
    <span className="tool-hint" role="status" data-testid="tool-hint">
      <strong>{label}</strong> {words} <kbd>Esc</kbd> {forkHeld ? "releases the fork" : "cancels"}
    </span>
  );
}

/** Render which point the pen's (stylus's) button marks, if the active tool can use a pen. */
export function PenText() {
  const pen = useApp((state) => (marksByPen(state.ui.armed) ? state.pen : null));
  if (pen === null) return null;
  return (
    <p className={pen.lps === null ? "warning-text" : "quiet"} role="status" data-testid="pen-words">
      {penMarkText(pen)}
    </p>
  );
}

/** Return the CSS cursor for an active tool: a cross with an open centre, beside the tool's icon. */
export function cursorOf(armed: Armed): string {
  const colour = takesAway(armed) ? INK.warning : INK.text;
  const cross = "M11 1v7M11 14v7M1 11h7M14 11h7";
  const tool = outlineOfIcon(TOOL_ICONS[armed]);
  const drawn = (stroke: string, width: number) =>
    `<g fill="none" stroke="${stroke}" stroke-width="${width}" stroke-linecap="round" stroke-linejoin="round">` +
    `<path d="${cross}"/><path transform="translate(16 16)" d="${tool}"/></g>`;
  const svg = `<svg xmlns="http://www.w3.org/2000/svg" width="32" height="32">${drawn("#08090c", 4)}${drawn(colour, 1.6)}</svg>`;
  return `url("data:image/svg+xml,${encodeURIComponent(svg)}") 11 11, crosshair`;
}
