/** Dialog that opens a series from a PACS: choice of the connection, search by patient or date, and list of series. */

import { useEffect, useRef, useState } from "react";
import { Button, Dialog, Form, Heading, Input, Label, Modal, ModalOverlay, TextField } from "react-aria-components";
import { keyOf } from "../input/keymap";
import { sizeText } from "../state/case-list";
import { sentence } from "../state/format";
import { addressText, dateRange, patientText, studyText } from "../state/pacs";
import type { PacsFields, PacsStudiesMessage } from "../wire/messages";
import { useApp, useStation } from "./context";
import { Act } from "./controls";
import { Icon } from "./icons";
import { Jobs } from "./Jobs";
import { PacsConnectionForm } from "./PacsConnectionForm";
import { PacsSeriesList } from "./PacsSeriesList";

const NONE: readonly PacsFields[] = [];

/** Render the dialog. */
export function PacsDialog() {
  const station = useStation();
  const open = useApp((state) => state.ui.pacsOpen);
  return (
    <ModalOverlay
      className="dialog-back"
      isOpen={open}
      isDismissable
      onOpenChange={(isOpen) => (isOpen ? station.openPacs() : station.closePacs())}
    >
      <Modal className="dialog pacs-dialog">
        <Dialog data-testid="pacs">
          <div className="dialog-head">
            <Heading slot="title">Open from a PACS</Heading>
            <Act kind="icon" icon="close" words="Close" keys={keyOf("leave")} onPress={station.closePacs} />
          </div>
          <Content />
        </Dialog>
      </Modal>
    </ModalOverlay>
  );
}

function Content() {
  const answer = useApp((state) => state.pacs.connections);
  const problem = useApp((state) => state.pacs.problem);
  const [chosen, setChosen] = useState<string | null>(null);
  const [edited, setEdited] = useState<PacsFields | "new" | null>(null);
  const connections = answer?.connections ?? NONE;
  // The form stays open until the server has saved the connection, so that a refused value can be corrected.
  const saving = useRef<string | null>(null);
  useEffect(() => {
    if (saving.current === null || answer === null) return;
    setChosen(saving.current);
    setEdited(null);
    saving.current = null;
  }, [answer]);
  const connection = connections.find(({ name }) => name === chosen) ?? connections[0] ?? null;
  if (answer === null) return problem === null ? <p className="quiet">Reading the connections…</p> : <Problem />;
  if (answer.problem !== null) {
    return (
      <p className="warning-text">
        <Icon name="warning" /> {sentence(answer.problem)}
      </p>
    );
  }
  if (edited !== null) {
    return (
      <>
        <PacsConnectionForm
          connection={edited === "new" ? null : edited}
          names={connections.map(({ name }) => name)}
          onSent={(name) => {
            saving.current = name;
          }}
          onCancel={() => {
            saving.current = null;
            setEdited(null);
          }}
        />
        <Problem />
      </>
    );
  }
  if (connection === null) {
    return (
      <>
        <Problem />
        <p className="empty">
          A PACS is the image archive of a hospital. Add the connection that its administrator gives you.
        </p>
        <div className="row">
          <Act
            kind="primary"
            label="Add a connection"
            words="Enter the address of a PACS"
            testId="add-pacs"
            onPress={() => setEdited("new")}
          />
        </div>
      </>
    );
  }
  return (
    <>
      <Connections
        connections={connections}
        connection={connection}
        onChoose={setChosen}
        onAdd={() => setEdited("new")}
        onEdit={() => setEdited(connection)}
      />
      <Test name={connection.name} />
      <Search name={connection.name} />
      <Problem />
      <Jobs />
      <Results name={connection.name} />
      <Retrieved />
    </>
  );
}

/** Render the reason for the failure of the last request, and what to do. */
function Problem() {
  const problem = useApp((state) => state.pacs.problem);
  return problem === null ? null : (
    <p className="warning-text" role="alert" data-testid="pacs-problem">
      <Icon name="warning" /> {sentence(problem.problem)}
    </p>
  );
}

interface ConnectionsProps {
  connections: readonly PacsFields[];
  connection: PacsFields;
  onChoose: (name: string) => void;
  onAdd: () => void;
  onEdit: () => void;
}

function Connections({ connections, connection, onChoose, onAdd, onEdit }: ConnectionsProps) {
  const station = useStation();
  const [deleting, setDeleting] = useState<string | null>(null);
  return (
    <section aria-label="Connection">
      <div className="row pacs-connection">
        <label>
          <span className="quiet">Connection</span>
          <select
            value={connection.name}
            data-testid="pacs-connection"
            onChange={(event) => {
              station.send({ type: "stop_pacs" });
              onChoose(event.target.value);
            }}
          >
            {connections.map(({ name }) => (
              <option key={name}>{name}</option>
            ))}
          </select>
        </label>
        <Act
          label="Test"
          words="Test the connection step by step"
          testId="test-pacs"
          onPress={() => station.send({ type: "test_pacs", name: connection.name })}
        />
        <Act label="Edit" words={`Change the address of ${connection.name}`} testId="edit-pacs" onPress={onEdit} />
        <Act label="Add" words="Add another connection" testId="add-pacs" onPress={onAdd} />
        {deleting === connection.name ? (
          <Act
            label="Delete now"
            words={`Delete ${connection.name} and its password; this cannot be undone`}
            testId="delete-pacs-now"
            onPress={() => {
              setDeleting(null);
              station.send({ type: "remove_pacs", name: connection.name });
            }}
          />
        ) : (
          <Act
            kind="quiet"
            label="Delete"
            words={`Delete ${connection.name}; asks again`}
            testId="delete-pacs"
            onPress={() => setDeleting(connection.name)}
          />
        )}
      </div>
      <p className="quiet small">{addressText(connection)}</p>
    </section>
  );
}

/** Render the steps of the last connection test. */
function Test({ name }: { name: string }) {
  const test = useApp((state) => state.pacs.test);
  if (test === null || test.name !== name) return null;
  return (
    <ul className="pacs-test" data-testid="pacs-test">
      {test.steps.map((step) => (
        <li key={step.name} className={step.passed ? "" : "warning-text"}>
          <Icon name={step.passed ? "info" : "warning"} />
          <span>
            <strong>{sentence(step.name)}</strong> {step.passed ? "passed" : "failed"}: {step.finding}
          </span>
        </li>
      ))}
    </ul>
  );
}

function Search({ name }: { name: string }) {
  const station = useStation();
  const [patient, setPatient] = useState("");
  const [patientId, setPatientId] = useState("");
  const [from, setFrom] = useState("");
  const [to, setTo] = useState("");
  const isEmpty = [patient, patientId, from, to].every((text) => text.trim() === "");
  return (
    <Form
      className="pacs-search"
      onSubmit={(event) => {
        event.preventDefault();
        if (isEmpty) return;
        station.send({
          type: "search_pacs",
          name,
          patient_name: patient.trim(),
          patient_id: patientId.trim(),
          date: dateRange(from, to),
        });
      }}
    >
      <Field label="Patient name" value={patient} onChange={setPatient} testId="pacs-patient" hint="FAMILY^GIVEN" />
      <Field label="Patient ID" value={patientId} onChange={setPatientId} testId="pacs-patient-id" />
      <Field label="Date from" type="date" value={from} onChange={setFrom} testId="pacs-from" />
      <Field label="to" type="date" value={to} onChange={setTo} testId="pacs-to" />
      <Button type="submit" className="button primary" isDisabled={isEmpty} data-testid="search-pacs">
        Search
      </Button>
    </Form>
  );
}

interface FieldProps {
  label: string;
  value: string;
  onChange: (value: string) => void;
  testId: string;
  type?: "text" | "date";
  hint?: string;
}

function Field({ label, value, onChange, testId, type = "text", hint }: FieldProps) {
  return (
    <TextField value={value} onChange={onChange} type={type} maxLength={64}>
      <Label>{label}</Label>
      <Input data-testid={testId} placeholder={hint} spellCheck="false" autoComplete="off" />
    </TextField>
  );
}

/** Render the found studies, or the series of the chosen study. */
function Results({ name }: { name: string }) {
  const found = useApp((state) => state.pacs.found);
  const [studyUid, setStudyUid] = useState<string | null>(null);
  if (found === null || found.name !== name) return null;
  const study = found.studies.find((one) => one.study_uid === studyUid) ?? null;
  return study === null ? (
    <Studies found={found} onChoose={setStudyUid} />
  ) : (
    <PacsSeriesList name={name} study={study} onBack={() => setStudyUid(null)} />
  );
}

function Studies({ found, onChoose }: { found: PacsStudiesMessage; onChoose: (uid: string) => void }) {
  const station = useStation();
  if (found.studies.length === 0) {
    return <p className="empty">No CT study matches. Check the spelling, or search by another field.</p>;
  }
  return (
    <section aria-label="Found studies">
      {found.has_more ? (
        <p className="warning-text" data-testid="pacs-more">
          <Icon name="warning" /> The first {found.studies.length} of more studies. Narrow the search to see the others.
        </p>
      ) : null}
      <ul className="pacs-list" data-testid="pacs-studies">
        {found.studies.map((study) => (
          <li key={study.study_uid}>
            <Button
              className="recent-case"
              onPress={() => {
                station.send({ type: "ask_pacs_series", name: found.name, study_uid: study.study_uid });
                onChoose(study.study_uid);
              }}
            >
              <span className="case-words">
                <span className="case-name">
                  {patientText(study.patient_name) || "No name"}
                  <span className="quiet">{study.patient_id === "" ? "" : ` \u00b7 ID ${study.patient_id}`}</span>
                </span>
                <span className="numbers quiet">{studyText(study)}</span>
              </span>
              <Icon name="chevron" />
            </Button>
          </li>
        ))}
      </ul>
      <p className="quiet small">Names are shown only here. Carina neither stores nor logs them.</p>
    </section>
  );
}

/** Render the space of the retrieved series on this machine, with a button that deletes them. */
function Retrieved() {
  const station = useStation();
  const answer = useApp((state) => state.pacs.connections);
  const hasCase = useApp((state) => state.session?.case != null);
  const [asking, setAsking] = useState(false);
  if (answer === null || answer.retrieved_bytes === 0) return null;
  return (
    <section className="pacs-retrieved">
      <span className="quiet small">
        Retrieved series use {sizeText(answer.retrieved_bytes)} in {answer.folder}.
      </span>
      {hasCase ? null : asking ? (
        <Act
          label="Delete all now"
          words="Delete the images of all retrieved series; your cases stay, and need their series again"
          testId="empty-pacs-now"
          onPress={() => {
            setAsking(false);
            station.send({ type: "empty_pacs" });
          }}
        />
      ) : (
        <Act
          kind="quiet"
          label="Delete"
          words="Delete the images of all retrieved series; asks again"
          testId="empty-pacs"
          onPress={() => setAsking(true)}
        />
      )}
    </section>
  );
}
