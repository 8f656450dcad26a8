/** Button that saves one image with all forks of the route. */

import { useApp, useStation } from "./context";
import { Act } from "./controls";

/** Render the button of the contact sheet; a disabled button states the reason. */
export function SaveForks() {
  const station = useStation();
  const watches = useApp((state) => state.watches);
  const problem = useApp(({ route, tree, ui }) => {
    if (route === null) return "There is no route yet. Choose a branch, or mark a target.";
    if (tree === null) return "The airways have not been segmented yet.";
    if (route.forks_mm.length === 0) return "This route passes no fork.";
    return ui.makingForks ? "The forks are being rendered. Wait, or cancel." : null;
  });
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
