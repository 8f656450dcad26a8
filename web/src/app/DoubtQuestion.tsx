/**
 * Question beside the tool whether to draw a branch by hand that the CT does not show. Enter draws it, Escape cancels.
 */

import { useEffect } from "react";
import { keyOf } from "../input/keymap";
import { doubtText } from "../state/edit-preview";
import { useApp, useStation } from "./context";
import { Act } from "./controls";

/** Render the question whether to draw the branch that the CT does not show; nothing without such a branch. */
export function DoubtQuestion() {
  const station = useStation();
  const doubt = useApp((state) => state.doubt);
  useEffect(() => {
    if (doubt === null) return;
    const onKey = (event: KeyboardEvent) => {
      const typing = event.target instanceof HTMLInputElement || event.target instanceof HTMLTextAreaElement;
      if (event.defaultPrevented || event.ctrlKey || event.metaKey || event.altKey || typing) return;
      // Do not handle Enter on a focused button, link or row, which Enter activates.
      const onButton = event.target instanceof HTMLElement && event.target.closest("button, a, [role=row]") !== null;
      if (event.key !== "Enter" || onButton) return;
      // Ignore a repeated key event: it comes from the Enter key that applied the tool and is still held.
      if (!event.repeat) station.answerDoubt(true);
      event.preventDefault();
      event.stopImmediatePropagation();
    };
    // Listen in the capture phase, because Enter in a view applies the tool. The table of keys handles Escape.
    window.addEventListener("keydown", onKey, { capture: true });
    return () => window.removeEventListener("keydown", onKey, { capture: true });
  }, [doubt, station]);
  if (doubt === null) return null;
  return (
    <div className="doubt" role="alert" data-testid="doubt">
      <p>{doubtText(doubt)}</p>
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
