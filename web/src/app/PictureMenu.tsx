/** Menu in a view's header that saves or copies a picture of the view. */

import { Button, Dialog, DialogTrigger, Popover } from "react-aria-components";
import { keyOf } from "../input/keymap";
import { markProblem, type PictureChoice, pictureName } from "../state/saved-picture";
import type { ViewName } from "../wire/messages";
import { LEAD_VIEW } from "../wire/views";
import { useApp, useStation } from "./context";
import { Act, Choice, IconLabel, SwitchKey, Tip, useKeysBack } from "./controls";
import { Icon } from "./icons";

/** Render the button that opens the menu; nothing in a window that only watches. */
export function PictureMenu({ view }: { view: ViewName }) {
  const watches = useApp((state) => state.watches);
  const shown = useApp((state) => state.frames[view] !== undefined);
  const keysBack = useKeysBack();
  if (watches) return null;
  const name = pictureName(view);
  const words = shown ? `Save or copy a picture of the ${name}` : `Nothing to save: the ${name} has no picture yet`;
  return (
    <DialogTrigger onOpenChange={keysBack.onOpenChange}>
      <Tip words={words} keys={view === LEAD_VIEW ? keyOf("save_picture") : ""}>
        <Button
          className="button icon"
          aria-label={words}
          isDisabled={!shown}
          onPressStart={keysBack.onPressStart}
          data-testid={`picture-menu-${view}`}
        >
          <Icon name="picture" />
          <IconLabel text="Picture" />
        </Button>
      </Tip>
      <Popover className="popover picture-menu" placement="bottom end" offset={4}>
        <Dialog aria-label={`Picture of the ${name}`}>{({ close }) => <Choices view={view} close={close} />}</Dialog>
      </Popover>
    </DialogTrigger>
  );
}

function Choices({ view, close }: { view: ViewName; close: () => void }) {
  const station = useStation();
  const choice = useApp((state) => state.ui.picture);
  const change = (part: Partial<PictureChoice>) => station.ui({ picture: { ...choice, ...part } });
  const noScale = markProblem(view, "scaleBar");
  const noNames = markProblem(view, "names");
  return (
    <>
      <Choice
        name="Size of the picture"
        value={String(choice.scale)}
        choices={[
          { value: "1", label: "Screen size", words: "As large as on the screen" },
          { value: "2", label: "2\u00d7", words: "Twice as wide and high, for print" },
        ]}
        onChange={(scale) => change({ scale: scale === "2" ? 2 : 1 })}
      />
      <div className="row">
        <SwitchKey
          label="Letters"
          words="Orientation letters at the edges"
          on={choice.letters}
          testId="picture-letters"
          onChange={() => change({ letters: !choice.letters })}
        />
        <SwitchKey
          label="Scale"
          words={noScale ?? "Scale in mm"}
          on={choice.scaleBar && noScale === null}
          disabled={noScale !== null}
          testId="picture-scale"
          onChange={() => change({ scaleBar: !choice.scaleBar })}
        />
        <SwitchKey
          label="Names"
          words={noNames ?? "Names of the branches"}
          on={choice.names && noNames === null}
          disabled={noNames !== null}
          testId="picture-names"
          onChange={() => change({ names: !choice.names })}
        />
      </div>
      <p className="quiet">Without outlines, targets and marks</p>
      <div className="row">
        <Act
          kind="primary"
          label="Save picture"
          words="Save as PNG. The file contains no patient name."
          testId="picture-save"
          onPress={() => {
            void station.pictures.save(view);
            close();
          }}
        />
        <Act
          label="Copy"
          words="Copy the picture, to paste it into a document"
          testId="picture-copy"
          onPress={() => {
            void station.pictures.copy(view);
            close();
          }}
        />
      </div>
    </>
  );
}
