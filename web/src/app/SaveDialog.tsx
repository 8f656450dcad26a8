/**
 * Dialog that saves the case as a named file. If another process has changed that file, the dialog asks which content
 * to keep.
 */

import { useState } from "react";
import { Button, Dialog, Form, Heading, Input, Label, Modal, ModalOverlay, TextField } from "react-aria-components";
import { keyOf } from "../input/keymap";
import { conflictChoices, namedPath } from "../state/named-file";
import type { ClientMessage, SavingInfo } from "../wire/messages";
import { useApp, useStation } from "./context";
import { Act } from "./controls";

/** Render the dialog that saves the case as a named file. */
export function SaveDialog() {
  const station = useStation();
  const open = useApp((state) => state.ui.saveOpen);
  const saving = useApp((state) => state.session?.saving ?? null);
  return (
    <ModalOverlay
      className="dialog-back"
      isOpen={open && saving !== null}
      isDismissable
      onOpenChange={(saveOpen) => station.ui({ saveOpen })}
    >
      <Modal className="dialog save-dialog">
        <Dialog data-testid="save-dialog">
          <div className="dialog-head">
            <Heading slot="title">Save the case as a file</Heading>
            <Act
              kind="icon"
              icon="close"
              words="Close"
              keys={keyOf("leave")}
              onPress={() => station.ui({ saveOpen: false })}
            />
          </div>
          {saving?.keeps === true ? (
            <>
              {saving.copy_conflict === null ? null : <Conflict saving={saving} />}
              <Where saving={saving} />
            </>
          ) : (
            <p>This case was not opened from a folder or file on this machine, so it cannot be saved.</p>
          )}
        </Dialog>
      </Modal>
    </ModalOverlay>
  );
}

/**
 * Render the choices for a named file whose content this window did not write. Nothing is written until the user
 * chooses.
 */
function Conflict({ saving }: { saving: SavingInfo }) {
  const station = useStation();
  const path = namedPath(saving);
  const choices = conflictChoices(saving);
  const send = (message: ClientMessage) => {
    if (station.send(message)) station.ui({ saveOpen: false });
  };
  if (path === null) return null;
  return (
    <fieldset className="save-conflict" data-testid="save-conflict" aria-label="The file was changed elsewhere">
      <p className="warning-text">{saving.copy_problem}</p>
      <div className="dialog-actions">
        {choices.beside === null ? null : (
          <Act
            label="Save as a new file"
            words={`Save this case as ${choices.beside}`}
            testId="save-beside"
            onPress={() => send({ type: "save_case", path: choices.beside })}
          />
        )}
        {choices.opens ? (
          <Act
            label="Open the other version"
            words={`Open ${saving.copy_name ?? ""} as it is now. Your changes stay in the list of recent cases.`}
            testId="open-theirs"
            onPress={() => send({ type: "open_path", path })}
          />
        ) : null}
        {choices.replaces ? (
          <Act
            label="Replace"
            words={`Rename the present file, then save this case as ${saving.copy_name ?? ""}`}
            testId="save-replace"
            onPress={() => send({ type: "save_case", path, replace: true })}
          />
        ) : null}
      </div>
    </fieldset>
  );
}

function Where({ saving }: { saving: SavingInfo }) {
  const station = useStation();
  const known = namedPath(saving);
  const [path, setPath] = useState(known ?? saving.suggested ?? "");
  return (
    <Form
      className="path-form"
      onSubmit={(event) => {
        event.preventDefault();
        const isSame = path.trim() === known;
        if (station.send({ type: "save_case", path: isSame ? null : path.trim() })) station.ui({ saveOpen: false });
      }}
    >
      <p>
        Carina saves your work on this machine as you go. Here you can also save it as one file, to move it to another
        machine or to share it. The file contains the airways, targets, key frames and history, but not the CT, the
        patient's name or any dates. It also contains the path of the CT relative to the file: before you share it,
        check that no folder name identifies the patient.
      </p>
      <TextField value={path} onChange={setPath} autoFocus>
        <Label>Folder and file name on this machine</Label>
        <Input spellCheck="false" autoComplete="off" data-testid="save-path" />
      </TextField>
      {saving.problem === null ? null : <p className="warning-text">{saving.problem}</p>}
      <div className="dialog-actions">
        <Button type="submit" className="button primary" isDisabled={path.trim() === ""} data-testid="save-now">
          Save
        </Button>
      </div>
    </Form>
  );
}
