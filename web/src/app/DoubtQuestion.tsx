/** At the tool: whether to draw by hand what the CT does not show. Enter draws it, Esc does not. */

import { useEffect } from "react";
import { keyOf } from "../input/keymap";
import { doubtWords } from "../state/edit-preview";
import { useApp, useStation } from "./context";
import { Act } from "./controls";

export function DoubtQuestion() {
  const station = useStation();
  const doubt = useApp((state) => state.doubt);
  useEffect(() => {
    if (doubt === null) return;
    const onKey = (event: KeyboardEvent) => {
      const typing = event.target instanceof HTMLInputElement || event.target instanceof HTMLTextAreaElement;
      if (event.defaultPrevented || event.ctrlKey || event.metaKey || event.altKey || typing) return;
      // A button that has the focus is pressed by Enter itself.
      const onButton = event.target instanceof HTMLElement && event.target.closest("button, a, [role=row]") !== null;
      if (event.key !== "Enter" || onButton) return;
      // Held since the tool was used by it: that is no second answer.
      if (!event.repeat) station.answerDoubt(true);
      event.preventDefault();
      event.stopImmediatePropagation();
    };
    // Before the pictures, where Enter uses the tool. Esc is the keymap's.
    window.addEventListener("keydown", onKey, { capture: true });
    return () => window.removeEventListener("keydown", onKey, { capture: true });
  }, [doubt, station]);
  if (doubt === null) return null;
  return (
    <div className="doubt" role="alert" data-testid="doubt">
      <p>{doubtWords(doubt)}</p>
      <div className="row">
        <Act
          label="Draw anyway"
          words="Draw the branch. It is labelled as drawn by hand and has no anatomical name."
          keys="Enter"
          testId="doubt-draw"
          onPress={() => station.answerDoubt(true)}
        />
        <Act
          kind="quiet"
          label="Cancel"
          words="Leave the tree unchanged"
          keys={keyOf("leave")}
          testId="doubt-cancel"
          onPress={() => station.answerDoubt(false)}
        />
      </div>
    </div>
  );
}
