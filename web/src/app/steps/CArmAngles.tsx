/** C-arm angles of the selected route, each with a button that shows the X-ray at these angles. */

import { sentence } from "../../state/format";
import { isCArmAt } from "../../state/plan";
import { viewZoomedBy } from "../../state/view-table";
import type { CArmPosition, PlansMessage } from "../../wire/messages";
import { VIEWS } from "../../wire/views";
import { useApp, useStation } from "../context";
import { Act } from "../controls";
import { Icon } from "../icons";

/** Render the C-arm angles of the selected route, in the words of report and command line. */
export function CArmAngles({ plans }: { plans: PlansMessage }) {
  const { carm, carm_standing: standing } = plans;
  return (
    <details className="turns carm-angles" data-testid="carm-angles" open>
      <summary>C-arm angles</summary>
      {carm === null ? (
        <p className="quiet" role="status">
          {standing === "failed" || standing === "stopped"
            ? "The search for C-arm angles has stopped."
            : standing === "making"
              ? "Searching angles at which target and tip are clear\u2026"
              : "The C-arm angles are computed after the verdict."}
        </p>
      ) : (
        <>
          {carm.why === null ? null : (
            <p className="warning-text" data-testid="carm-why">
              <Icon name="warning" /> {sentence(carm.why)}.
            </p>
          )}
          <ol>
            {carm.angles.map((position, index) => (
              <Position key={position.name} position={position} number={index + 1} />
            ))}
          </ol>
          {carm.notes.map((note) => (
            <p key={note} className="warning-text">
              <Icon name="warning" /> {sentence(note)}.
            </p>
          ))}
          <p className="quiet">{carm.limits}</p>
        </>
      )}
    </details>
  );
}

function Position({ position, number }: { position: CArmPosition; number: number }) {
  const station = useStation();
  const view = viewZoomedBy("carm");
  const shown = useApp((state) => state.ui.shown[VIEWS[view].cell] === view && isCArmAt(state.sight.carm, position));
  return (
    <li className={shown ? "chosen" : undefined} data-testid={`carm-${number}`}>
      <span>{position.words}</span>
      <Act
        kind="quiet"
        label={shown ? "Shown in the X-ray view" : "Show X-ray"}
        words={`Show the simulated X-ray at ${position.name}, with target and planned tip`}
        testId={`show-carm-${number}`}
        onPress={() => station.showFromCArm(position)}
      />
    </li>
  );
}
