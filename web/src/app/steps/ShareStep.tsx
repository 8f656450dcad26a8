import { keyOf } from "../../input/keymap";
import { EXPORTS } from "../../wire/exports";
import { useApp, useStation } from "../context";
import { Act } from "../controls";

/** Render the panel of the Share step. */
export function ShareStep() {
  const station = useStation();
  const found = useApp((state) => state.session?.airways === "found");
  const making = useApp((state) => state.ui.making);
  return (
    <>
      <p>
        {found
          ? "Save the current airways to files."
          : "The airways can be saved to files once they have been segmented."}
      </p>
      {EXPORTS.map(({ title, files }) => (
        <div key={title} className="group">
          <h3>{title}</h3>
          <div className="row">
            {files.map(({ suffix, words }) => (
              <Act
                key={suffix}
                label={making === suffix ? "Preparing\u2026" : suffix.replace(/^\./, "")}
                words={words}
                disabled={!found || making !== null}
                testId={`take${suffix}`}
                onPress={() => void station.transfers.takeAirways(suffix)}
              />
            ))}
          </div>
        </div>
      ))}
      <p className="quiet">
        The files do not contain the patient's name, but the anatomy can identify the patient: handle them as carefully
        as the CT.
      </p>
      <details className="part">
        <summary>Details</summary>
        <p>The files are in patient coordinates, LPS mm.</p>
      </details>
      <Act
        icon="capture"
        label="Key frames"
        words="Views joined into a smooth flight at a set speed, for a video"
        keys={keyOf("key_frames")}
        testId="to-keys"
        onPress={() => station.act("key_frames")}
      />
      <p className="quiet">For a video, use Save video under Route, Key frames, or a flight recorded under Rehearse.</p>
    </>
  );
}
