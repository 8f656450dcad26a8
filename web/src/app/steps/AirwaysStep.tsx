import { keyOf } from "../../input/keymap";
import { coordinates, plural, sentence } from "../../state/format";
import { asVec3 } from "../../state/vec";
import { useApp, useStation } from "../context";
import { Act, SwitchKey } from "../controls";
import { Threshold } from "./Threshold";

export function AirwaysStep() {
  const station = useStation();
  const session = useApp((state) => state.session);
  const count = useApp((state) => state.tree?.byId.size ?? 0);
  const armed = useApp((state) => state.ui.armed === "root");
  if (session === null) return null;
  const found = session.airways === "found";
  return (
    <>
      <p>
        {session.airways === "found"
          ? `${plural(count, "branch", "branches")} found automatically. Compare them with the slices before you rely on them.`
          : session.airways === "finding"
            ? "The airways are being found. You can fly freely meanwhile."
            : session.airways === "failed"
              ? "No airways were found."
              : "The airways will be found as soon as the CT is ready."}
      </p>
      {session.airways_words === null ? null : <p className="quiet">{sentence(session.airways_words)}</p>}
      <h3>Root</h3>
      <p className="quiet numbers">
        {session.root_lps === null ? "Found by itself in the trachea." : coordinates(asVec3(session.root_lps))}
      </p>
      <SwitchKey
        icon="target"
        label={armed ? "Click in a slice\u2026" : "Set the root"}
        words="The next click in a slice begins the airways there"
        keys={keyOf("arm_root")}
        on={armed}
        onChange={() => station.act("arm_root")}
      />
      <Threshold />
      <Act
        kind="primary"
        label="Go on to the target"
        words="Next step"
        disabled={!found}
        onPress={() => station.ui({ step: "target" })}
      />
    </>
  );
}
