/** Text of the top bar about the saved state of the case. */

import { Button } from "react-aria-components";
import { keyOf } from "../input/keymap";
import { savedText } from "../state/save-status";
import { useApp, useStation } from "./context";
import { Tip } from "./controls";

/** Render the saved state of the case; nothing without a case. */
export function SavedText() {
  const station = useStation();
  const saving = useApp((state) => state.session?.saving ?? null);
  const saved = savedText(saving, Date.now());
  if (saved === null) return null;
  return (
    <Tip words={saved.words} keys={keyOf("save")}>
      <Button
        className={saved.warns ? "saved badge warning" : "saved plain-text quiet"}
        data-testid="saved"
        onPress={() => station.ui({ saveOpen: true })}
      >
        {saved.label}
      </Button>
    </Tip>
  );
}
