/** Tools that edit the airway tree: their buttons, and the instruction and settings of the active tool. */

import { type Action, keyOf } from "../input/keymap";
import { shownBranch } from "../state/app-state";
import { mm } from "../state/format";
import { isBrush, isTreeTool, nextBrush, TOOL_TEXTS, TREE_TOOLS, type TreeTool, textsOf } from "../state/tools";
import { useApp, useStation } from "./context";
import { Act, SwitchKey } from "./controls";
import { DoubtQuestion } from "./DoubtQuestion";
import { TOOL_ICONS } from "./ToolTag";

const ACTIONS: Readonly<Record<TreeTool, Action>> = {
  add: "tool_add",
  bridge: "tool_bridge",
  cut: "tool_cut",
  fork: "tool_fork",
  smooth: "tool_smooth",
  paint: "tool_paint",
  erase: "tool_erase",
  reroot: "tool_reroot",
};

/** Render the buttons of the tools that edit the airway tree. */
export function EditTools() {
  const station = useStation();
  const armed = useApp((state) => state.ui.armed);
  const shown = useApp(shownBranch);
  return (
    <div className="edit-tools" role="toolbar" aria-label="Edit the tree">
      {TREE_TOOLS.map((tool) => (
        <SwitchKey
          key={tool}
          icon={TOOL_ICONS[tool]}
          label={TOOL_TEXTS[tool].short}
          words={TOOL_TEXTS[tool].words}
          keys={keyOf(ACTIONS[tool])}
          on={armed === tool}
          testId={`tool-${tool}`}
          onChange={() => station.act(ACTIONS[tool])}
        />
      ))}
      <Act
        icon="pencil"
        label="Name"
        words="Rename the selected branch"
        keys={keyOf("rename")}
        disabled={shown === null}
        onPress={() => station.act("rename")}
      />
    </div>
  );
}

/** Render the instruction and the settings of the tool that is active. */
export function ToolInHand() {
  const station = useStation();
  const armed = useApp((state) => state.ui.armed);
  const forkHeld = useApp((state) => state.ui.forkHeld);
  const brushMm = useApp((state) => state.ui.brushMm);
  const ball = useApp((state) => state.ui.brushIsBall);
  const doubted = useApp((state) => state.doubt !== null);
  if (!isTreeTool(armed)) return <DoubtQuestion />;
  const { label, hint } = textsOf(armed, forkHeld !== null);
  return (
    <div className="in-hand" role="status" data-testid="in-hand">
      <header>
        <strong>{label}</strong>
        <Act
          kind="quiet"
          label="Done"
          words="Stop using this tool"
          keys={keyOf("leave")}
          onPress={() => station.disarm()}
        />
      </header>
      {doubted ? <DoubtQuestion /> : <p>{hint}</p>}
      {isBrush(armed) ? (
        <div className="row brush">
          <Act
            kind="icon"
            icon="back"
            words="Smaller brush"
            keys={keyOf("brush_smaller")}
            onPress={() => station.ui({ brushMm: nextBrush(brushMm, -1) })}
          />
          <span className="numbers" title="Brush width">
            {mm(2 * brushMm)}
          </span>
          <Act
            kind="icon"
            icon="forward"
            words="Larger brush"
            keys={keyOf("brush_larger")}
            onPress={() => station.ui({ brushMm: nextBrush(brushMm, 1) })}
          />
          <SwitchKey
            label="3D"
            words={
              ball
                ? "The brush paints in 3D. Click to paint in this slice only."
                : "The brush paints in this slice only. Click to paint in 3D."
            }
            on={ball}
            onChange={() => station.ui({ brushIsBall: !ball })}
          />
        </div>
      ) : null}
    </div>
  );
}
