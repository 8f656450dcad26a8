/** Button that saves one image with all forks of the route. */

import { forksProblem } from "../state/fork-sheet";
import { useApp, useStation } from "./context";
import { Act } from "./controls";

/** Render the button of the contact sheet; a disabled button states the reason. */
export function SaveForks() {
  const station = useStation();
  const watches = useApp((state) => state.watches);
  const problem = useApp(forksProblem);
  if (watches) return null;
  return (
    <Act
      icon="fork"
      label="Save forks"
      words={problem ?? "Save one picture with all forks of this route, each with its clock hour"}
      disabled={problem !== null}
      testId="save-forks"
      onPress={() => void station.pictures.saveForks()}
    />
  );
}
