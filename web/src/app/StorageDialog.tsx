/** Dialog of all cases: disk usage of the cases and their CTs, and buttons to rename, forget and restore a case. */

import { useEffect, useState } from "react";
import { Button, Dialog, Form, Heading, Input, Modal, ModalOverlay, TextField } from "react-aria-components";
import { keyOf } from "../input/keymap";
import { caseFacts, FORGOTTEN_FOR, sizeText } from "../state/case-list";
import type { RecentCase, Storage } from "../wire/messages";
import { useApp, useStation } from "./context";
import { Act } from "./controls";
import { CasePicture, CaseText } from "./RecentCases";

const NONE: readonly RecentCase[] = [];

/** Render the dialog of all cases. */
export function StorageDialog() {
  const station = useStation();
  const open = useApp((state) => state.ui.storageOpen);
  useEffect(() => {
    if (!open) return;
    // When a pressed button disappears with its row, no element of the dialog has the focus, and the page receives the
    // Escape key.
    const closeFromPage = (event: KeyboardEvent) => {
      if (event.key === "Escape" && document.activeElement === document.body) station.ui({ storageOpen: false });
    };
    window.addEventListener("keydown", closeFromPage);
    return () => window.removeEventListener("keydown", closeFromPage);
  }, [open, station]);
  return (
    <ModalOverlay
      className="dialog-back"
      isOpen={open}
      isDismissable
      onOpenChange={(storageOpen) => station.ui({ storageOpen })}
    >
      <Modal className="dialog storage-dialog">
        <Dialog data-testid="storage">
          <div className="dialog-head">
            <Heading slot="title">Cases and storage</Heading>
            <Act
              kind="icon"
              icon="close"
              words="Close"
              keys={keyOf("leave")}
              onPress={() => station.ui({ storageOpen: false })}
            />
          </div>
          <Cases />
          <Beside />
        </Dialog>
      </Modal>
    </ModalOverlay>
  );
}

function Cases() {
  const recent = useApp((state) => state.start?.recent ?? NONE);
  const [renaming, setRenaming] = useState<string | null>(null);
  const total = recent.reduce((sum, { num_bytes }) => sum + num_bytes, 0);
  return (
    <section aria-labelledby="cases-heading">
      <div className="recent-head">
        <h3 id="cases-heading">Cases</h3>
        <span className="numbers quiet">{sizeText(total)}</span>
      </div>
      {recent.length === 0 ? (
        <p className="empty">The cases you open appear here.</p>
      ) : (
        <ul className="stored" data-testid="stored">
          {recent.map((entry) => (
            <li key={entry.recent_id}>
              {renaming === entry.recent_id ? (
                <Rename entry={entry} onEnd={() => setRenaming(null)} />
              ) : (
                <Row entry={entry} all={recent} onRename={() => setRenaming(entry.recent_id)} />
              )}
            </li>
          ))}
        </ul>
      )}
      <p className="quiet">
        Cases are stored until you forget them. A forgotten case can be restored for {FORGOTTEN_FOR}. Forgetting a case
        never deletes its CT or a file that you saved.
      </p>
    </section>
  );
}

function Row({ entry, all, onRename }: { entry: RecentCase; all: readonly RecentCase[]; onRename: () => void }) {
  const station = useStation();
  return (
    <>
      <CaseText entry={entry} all={all} />
      <span className="numbers quiet">{entry.num_changes === null ? "" : sizeText(entry.num_bytes)}</span>
      {entry.num_changes === null ? (
        <span />
      ) : (
        <Act kind="icon" icon="pencil" words="Rename this case" testId="rename-case" onPress={onRename} />
      )}
      <Act
        label="Forget"
        words={
          entry.num_changes === null
            ? "Remove this CT from the list; its files are not deleted"
            : `Remove this case and the cached CT; it can be restored for ${FORGOTTEN_FOR}`
        }
        testId="forget-case"
        onPress={() => station.send({ type: "forget_case", recent_id: entry.recent_id })}
      />
    </>
  );
}

function Rename({ entry, onEnd }: { entry: RecentCase; onEnd: () => void }) {
  const station = useStation();
  const [title, setTitle] = useState(entry.named ? entry.title : "");
  return (
    <>
      <CasePicture entry={entry} />
      <Form
        className="rename-case"
        onSubmit={(event) => {
          event.preventDefault();
          const name = title.trim();
          station.send({ type: "rename_case", recent_id: entry.recent_id, title: name === "" ? null : name });
          onEnd();
        }}
      >
        <TextField
          value={title}
          onChange={setTitle}
          onKeyDown={(event) => {
            if (event.key === "Escape") onEnd();
            else event.continuePropagation();
          }}
          autoFocus
          maxLength={80}
          aria-label="Case name"
        >
          <Input
            placeholder={entry.named ? "Leave empty to use a random code" : entry.title}
            autoComplete="off"
            data-testid="case-name"
          />
        </TextField>
        <Button type="submit" className="button primary">
          Rename
        </Button>
      </Form>
    </>
  );
}

function Beside() {
  const storage = useApp((state) => state.start?.storage ?? null);
  if (storage === null) return null;
  return (
    <>
      {storage.forgotten.length === 0 ? null : <Forgotten forgotten={storage.forgotten} />}
      <CachedCts storage={storage} />
    </>
  );
}

function Forgotten({ forgotten }: { forgotten: readonly RecentCase[] }) {
  const station = useStation();
  return (
    <section aria-labelledby="forgotten-heading">
      <div className="recent-head">
        <h3 id="forgotten-heading">Forgotten</h3>
        <Act
          kind="quiet"
          label="Delete permanently"
          words="Delete all forgotten cases now; this cannot be undone"
          testId="empty-forgotten"
          onPress={() => station.send({ type: "empty_forgotten" })}
        />
      </div>
      <ul className="stored forgotten" data-testid="forgotten">
        {forgotten.map((entry) => (
          <li key={entry.recent_id}>
            <CasePicture entry={entry} />
            <span className="case-words">
              <span className="case-name">{entry.title}</span>
              <span className="numbers quiet">{caseFacts(entry, forgotten, Date.now()).join(" \u00b7 ")}</span>
            </span>
            <span className="numbers quiet">{sizeText(entry.num_bytes)}</span>
            <span />
            <Act
              label="Restore"
              words="Restore this case to the list"
              testId="restore-case"
              onPress={() => station.send({ type: "restore_case", recent_id: entry.recent_id })}
            />
          </li>
        ))}
      </ul>
      <p className="quiet">Forgotten cases are deleted the first time Carina starts after {FORGOTTEN_FOR}.</p>
    </section>
  );
}

function CachedCts({ storage }: { storage: Storage }) {
  const station = useStation();
  const on = storage.keeps_cts === "on";
  return (
    <section aria-labelledby="cached-heading">
      <div className="recent-head">
        <h3 id="cached-heading">Cached CTs</h3>
        <span className="numbers quiet">{sizeText(storage.ct_bytes)}</span>
      </div>
      <p className="quiet">
        {on
          ? `${storage.num_cts === 0 ? "No CTs are" : storage.num_cts === 1 ? "1 CT is" : `${storage.num_cts} CTs are`} cached. A cached CT opens faster. Your work is not stored in the cache, so it can be emptied at any time.`
          : storage.keeps_cts === "off"
            ? "The cache is off: each CT is read from its original files."
            : "The cache is off, because Carina was started without it."}
      </p>
      {storage.keeps_cts === "never" ? null : (
        <div className="row">
          <Act
            label={on ? "Turn the cache off" : "Turn the cache on"}
            words={on ? "Empty the cache; CTs are then read from their original files" : "Cache CTs opened from now on"}
            testId="switch-cache"
            onPress={() => station.send({ type: "keep_cts", on: !on })}
          />
          {on ? (
            <Act
              label="Empty"
              words="Remove the cached CTs; their files are not deleted"
              disabled={storage.num_cts === 0}
              testId="empty-cache"
              onPress={() => station.send({ type: "empty_ct_cache" })}
            />
          ) : null}
        </div>
      )}
    </section>
  );
}
