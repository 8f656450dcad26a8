import { keyOf } from "../../input/keymap";
import { coordinates, plural, sentence } from "../../state/format";
import { asVec3 } from "../../state/vec";
import { BranchPanel } from "../BranchPanel";
import { useApp, useStation } from "../context";
import { Act, SwitchKey } from "../controls";
import { EditTools, ToolInHand } from "../EditTools";
import { MaskPicker } from "../MaskImport";
import { PenText } from "../ToolTag";
import { Threshold } from "./Threshold";

/** Render the panel of the Airways step. */
export function AirwaysStep() {
  const station = useStation();
  const session = useApp((state) => state.session);
  const count = useApp((state) => state.tree?.byId.size ?? 0);
  if (session === null) return null;
  const found = session.airways === "found";
  return (
    <>
      <ToolInHand />
      {found ? (
        <details className="part">
          <summary>{plural(count, "branch", "branches")} found</summary>
          <p>
            {session.airways_from === "mask" ? "Imported" : "Automatic"} segmentation: compare it with the slices before
            you rely on it.
          </p>
          {session.airways_words === null ? null : <p className="quiet">{sentence(session.airways_words)}</p>}
        </details>
      ) : (
        <>
          <p>
            {session.airways === "finding"
              ? "Segmenting the airways. You can fly freely in the meantime."
              : session.airways === "failed"
                ? "No airways were found."
                : "The airways will be segmented as soon as the CT is ready."}
          </p>
          {session.airways_words === null ? null : <p className="quiet">{sentence(session.airways_words)}</p>}
        </>
      )}
      {found ? (
        <>
          <h3>Edit the tree</h3>
          <EditTools />
          <BranchPanel />
          <details className="part">
            <summary>Segment again, or use another segmentation</summary>
            <Root />
            <MaskPicker />
          </details>
        </>
      ) : (
        <>
          <Root />
          <MaskPicker />
        </>
      )}
      <Act
        kind="primary"
        label="Continue to the target"
        words="Next step"
        disabled={!found && session.airways !== "failed"}
        onPress={() => station.toStep("target")}
      />
    </>
  );
}

/** Render the start point and the air threshold of the airway segmentation. */
function Root() {
  const station = useStation();
  const rootLps = useApp((state) => state.session?.root_lps ?? null);
  const armed = useApp((state) => state.ui.armed === "root");
  return (
    <div className="root-part">
      <p className="quiet numbers">
        Start: {rootLps === null ? "automatic, in the trachea" : coordinates(asVec3(rootLps))}
      </p>
      <SwitchKey
        icon="target"
        label={armed ? "Click in a view\u2026" : "Mark the trachea"}
        words="Click inside the trachea to segment the airways again from its upper end. This will discard your edits (Undo restores them)."
        keys={keyOf("arm_root")}
        on={armed}
        onChange={() => station.act("arm_root")}
      />
      <PenText />
      <Threshold />
    </div>
  );
}
