/** Notice that a saved case is continued, with a button that begins a new case (decision 0127). */

import { continuedText } from "../state/case-list";
import { useApp, useStation } from "./context";
import { Act } from "./controls";

/** Render the notice that a saved case is continued; nothing once the user has closed it or has changed the case. */
export function ContinuedBar() {
  const station = useStation();
  const saving = useApp((state) => state.session?.saving ?? null);
  const numChanges = useApp((state) => state.history?.step ?? 0);
  const readS = useApp((state) => state.ui.continuedReadS);
  const words = continuedText(saving, numChanges, readS, Date.now());
  if (words === null) return null;
  return (
    <section className="continued" aria-label="Continued case" data-testid="continued">
      <p role="status">
        {words}{" "}
        <span className="quiet">To start over, choose New case; this work stays in the list of recent cases.</span>
      </p>
      <div className="row">
        <Act
          kind="primary"
          label="Continue"
          words="Hide this message and continue with these changes"
          testId="continue"
          onPress={() => station.ui({ continuedReadS: saving?.continued_s ?? null })}
        />
        <Act
          label="New case"
          words="Segment this CT again without these changes; this case stays in the list of recent cases"
          testId="begin-anew"
          onPress={() => station.send({ type: "begin_anew" })}
        />
      </div>
    </section>
  );
}
