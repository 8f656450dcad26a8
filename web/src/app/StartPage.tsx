/** Start page: drop a folder, continue a recent case, or open a demo. */

import { type DragEvent, useState } from "react";
import { Button, FileTrigger, Form, Input, Label, TextField } from "react-aria-components";
import { filesOfDrop, filesOfPicker, type UploadFile } from "../net/upload";
import { Citation } from "./Citation";
import { useApp, useStation } from "./context";
import { Act, Tip } from "./controls";
import { Icon } from "./icons";
import { Jobs } from "./Jobs";
import { RecentCases } from "./RecentCases";
import { StorageDialog } from "./StorageDialog";

/** Render the start page. */
export function StartPage() {
  const version = useApp((state) => state.version);
  return (
    <main className="start" data-testid="start">
      <header>
        <h1>Carina</h1>
        <p>Fly through the airways of a chest CT.</p>
      </header>
      <div className="start-grid">
        <section aria-labelledby="open-heading">
          <h2 id="open-heading">Open a CT</h2>
          <DropPlace />
          <PathForm />
          <Jobs />
          <RecentCases />
        </section>
        <section aria-labelledby="demo-heading">
          <h2 id="demo-heading">Or look at an example</h2>
          <Demos />
        </section>
      </div>
      <footer>
        <strong>Not a medical device.</strong> For research, teaching and rehearsal; not for diagnosis. Your images stay
        on this machine.
        <span className="quiet">{version === null ? "" : ` Carina ${version}`}</span>
      </footer>
      <StorageDialog />
    </main>
  );
}

function DropPlace() {
  const station = useStation();
  const [over, setOver] = useState(false);
  const drop = (event: DragEvent) => {
    event.preventDefault();
    setOver(false);
    void filesOfDrop(event.dataTransfer.items).then((files) => station.transfers.upload(files));
  };
  return (
    // biome-ignore lint/a11y/noStaticElementInteractions: the buttons inside give keyboard access
    <div
      className={over ? "drop over" : "drop"}
      onDragOver={(event) => {
        event.preventDefault();
        setOver(true);
      }}
      onDragLeave={() => setOver(false)}
      onDrop={drop}
    >
      <Icon name="folder" />
      <p>
        <strong>Drop a folder, a file or an archive (zip, tar, 7z) here</strong>
        <br />
        <span className="quiet">a DICOM series or CD, NIfTI, NRRD, MetaImage, VTI or a Carina case</span>
      </p>
      <Pickers />
      <PacsButton />
    </div>
  );
}

/** Render the button that opens the dialog of the PACS; nothing in a browser on another machine. */
export function PacsButton() {
  const station = useStation();
  const atMachine = useApp((state) => state.atMachine);
  return !atMachine ? null : (
    <Act
      label="Open from a PACS"
      words="Search the image archive of your hospital, and open a series"
      testId="open-pacs"
      onPress={station.openPacs}
    />
  );
}

/** Render the buttons that open the system's file and folder dialogs; the files are opened as a case by default. */
export function Pickers({ onFiles }: { onFiles?: (files: readonly UploadFile[]) => void }) {
  const station = useStation();
  const pick = (list: FileList | null) => {
    if (list === null || list.length === 0) return;
    if (onFiles === undefined) void station.transfers.upload(filesOfPicker(list));
    else onFiles(filesOfPicker(list));
  };
  return (
    <div className="row">
      <FileTrigger acceptDirectory onSelect={pick}>
        <Tip words="Choose a folder with a DICOM series">
          <Button className="button">Choose folder</Button>
        </Tip>
      </FileTrigger>
      <FileTrigger onSelect={pick}>
        <Tip words="Choose a NIfTI, NRRD, MetaImage or VTI file, an archive, a DICOMDIR, or a Carina case">
          <Button className="button">Choose file</Button>
        </Tip>
      </FileTrigger>
    </div>
  );
}

/** Render the form that opens a case from a path on the server's computer. */
export function PathForm() {
  const station = useStation();
  const [path, setPath] = useState("");
  return (
    <Form
      className="path-form"
      onSubmit={(event) => {
        event.preventDefault();
        if (path.trim() !== "") station.openPath(path.trim());
      }}
    >
      <TextField value={path} onChange={setPath}>
        <Label>or type the path of a folder or file on this machine (it is not copied)</Label>
        <div className="row">
          <Input placeholder="/data/ct/series" spellCheck="false" autoComplete="off" />
          <Tip words="Open this path" keys="Enter">
            <Button type="submit" className="button primary" isDisabled={path.trim() === ""}>
              Open
            </Button>
          </Tip>
        </div>
      </TextField>
    </Form>
  );
}

function Demos() {
  const station = useStation();
  const demos = useApp((state) => state.start?.demos ?? null);
  return (
    <div className="demos">
      {(demos ?? []).map((demo) => (
        <article key={demo.name} className="demo">
          <img src={`./demo-${demo.name}.jpg`} alt="" width={392} height={294} />
          <div>
            <h3>{demo.title}</h3>
            <p>{demo.words}</p>
            <Act
              kind="primary"
              label="Open this example"
              words={`Open: ${demo.title}`}
              testId={`demo-${demo.name}`}
              onPress={() => station.openDemo(demo.name)}
            />
          </div>
          {demo.citation === null ? null : <Citation from={demo.citation} />}
        </article>
      ))}
    </div>
  );
}
