/**
 * Question beside the tool whether to draw a branch by hand that the CT does not show. Enter draws it, Escape cancels.
 */

import { useEffect } from "react";
import { keyOf } from "../input/keymap";
import { doubtWords } from "../state/edit-preview";
import { useApp, useStation } from "./context";
import { Act } from "./controls";

/** Render the question. */
export function DoubtQuestion() {
  const station = useStation();
  const doubt = useApp((state) => state.doubt);
  useEffect(() => {
    if (doubt === null) return;
    const onKey = (event: KeyboardEvent) => {
      const typing = event.target instanceof HTMLInputElement || event.target instanceof HTMLTextAreaElement;
      if (event.defaultPrevented || event.ctrlKey || event.metaKey || event.altKey || typing) return;
      // Enter on a focused button presses that button.
      const onButton = event.target instanceof HTMLElement && event.target.closest("button, a, [role=row]") !== null;
      if (event.key !== "Enter" || onButton) return;
      // A repeated key event is from the Enter key that applied the tool, and not an answer.
      if (!event.repeat) station.answerDoubt(true);
      event.preventDefault();
      event.stopImmediatePropagation();
    };
    // Capture Enter before the views, where Enter applies the tool. The keymap handles Escape.
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
