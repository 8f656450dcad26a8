/** Dialogs of the page: the safety notice at the first start, and the card of keys. */

import { Button, Dialog, Heading, Modal, ModalOverlay } from "react-aria-components";
import { MOUSE } from "../input/key-table";
import { keyOf, keySections } from "../input/keymap";
import { trainingLayout } from "../state/training";
import { useApp, useStation } from "./context";
import { Act } from "./controls";

/** Render the safety notice until the user has accepted it. */
export function NoticeDialog() {
  const station = useStation();
  const due = useApp((state) => state.start?.notice_accepted === false);
  return (
    <ModalOverlay className="dialog-back" isOpen={due} isKeyboardDismissDisabled>
      <Modal className="dialog notice-dialog">
        <Dialog role="alertdialog">
          <Heading slot="title">Carina is not a medical device</Heading>
          <p>
            It is software for research, teaching and rehearsal. It has not been evaluated or approved for diagnosis or
            treatment, and its automatic results can be wrong: airways may be missing or wrongly joined, and noise may
            appear as airways.
          </p>
          <p>Decisions about a patient must be made by a physician, from the original images.</p>
          <div className="quiet" data-testid="stored-on-disk">
            <p>Your images stay on this machine, unless you share a case. Carina stores, readable by you alone:</p>
            <ul>
              <li>Cases: your work, the name that you give a case, the date of the scan and a small picture.</li>
              <li>
                The path of each CT, and of each file that you save a case to, so that the case can be opened again. A
                path can contain a patient's name.
              </li>
              <li>Copies of opened CTs with their paths and series names, until you empty the cache.</li>
              <li>Series that you retrieve from a PACS, and the addresses of the PACS, until you delete them.</li>
              <li>Dropped files, until they have been read; several series, until another case is opened.</li>
            </ul>
            <p>
              Unnamed cases are shown as "Case" with a random code. Observers, phones and reports do not receive the
              name of a CT file. See Cases and storage to delete what is stored.
            </p>
          </div>
          <div className="dialog-actions">
            <Button
              autoFocus
              className="button primary"
              data-testid="notice-accept"
              onPress={() => station.send({ type: "accept_notice" })}
            >
              I have read this
            </Button>
          </div>
        </Dialog>
      </Modal>
    </ModalOverlay>
  );
}

/** Render the button that starts the tour; nothing without a case, and in a window that only watches. */
function TourButton() {
  const station = useStation();
  const there = useApp((state) => state.session?.case != null && !state.watches && trainingLayout(state) === undefined);
  return there ? (
    <Act label="Two-minute tour" words="Explain the window" testId="tour" onPress={() => station.tourTo(0)} />
  ) : null;
}

/** Render the card of keys and mouse gestures. */
export function KeyCard() {
  const station = useStation();
  const open = useApp((state) => state.ui.keyCardOpen);
  return (
    <ModalOverlay
      className="dialog-back"
      isOpen={open}
      isDismissable
      onOpenChange={(keyCardOpen) => station.ui({ keyCardOpen })}
    >
      <Modal className="dialog key-card">
        <Dialog data-testid="key-card">
          <div className="dialog-head">
            <Heading slot="title">Keys and mouse</Heading>
            <TourButton />
            <Act
              kind="icon"
              icon="close"
              words="Close"
              keys={keyOf("leave")}
              onPress={() => station.ui({ keyCardOpen: false })}
            />
          </div>
          <div className="key-columns">
            {keySections().map(({ title, rows }) => (
              <section key={title}>
                <h3>{title}</h3>
                <dl>
                  {rows.map((binding) => (
                    <div key={binding.label}>
                      <dt>
                        <kbd>{binding.label}</kbd>
                      </dt>
                      <dd>{binding.words}</dd>
                    </div>
                  ))}
                </dl>
              </section>
            ))}
            {MOUSE.map((part) => (
              <section key={part.where}>
                <h3>{part.where}</h3>
                <dl className="mouse">
                  {part.what.map(([how, what]) => (
                    <div key={how}>
                      <dt>{how}</dt>
                      <dd>{what}</dd>
                    </div>
                  ))}
                </dl>
              </section>
            ))}
          </div>
        </Dialog>
      </Modal>
    </ModalOverlay>
  );
}
