/** Form that adds or edits the connection to a PACS: DICOM (DIMSE) or DICOMweb. */

import { useState } from "react";
import { Button, Form, Input, Label, TextField } from "react-aria-components";
import { NEW_CONNECTION } from "../state/pacs";
import type { PacsFields } from "../wire/messages";
import { useStation } from "./context";
import { Act, Choice } from "./controls";

interface PacsConnectionFormProps {
  /** The connection to edit; null adds one. */
  connection: PacsFields | null;
  names: readonly string[];
  /** Called when the connection was sent to the server, which saves or refuses it. */
  onSent: (name: string) => void;
  onCancel: () => void;
}

type Kind = "dimse" | "web";

/** Render the form. */
export function PacsConnectionForm({ connection, names, onSent, onCancel }: PacsConnectionFormProps) {
  const station = useStation();
  const [fields, setFields] = useState<PacsFields>(connection ?? NEW_CONNECTION);
  const [kind, setKind] = useState<Kind>(connection !== null && connection.url !== "" ? "web" : "dimse");
  const [password, setPassword] = useState<string | null>(null);
  const change = (part: Partial<PacsFields>) => setFields((before) => ({ ...before, ...part }));
  const name = fields.name.trim();
  const isTaken = names.includes(name) && name !== connection?.name;
  const isWeb = kind === "web";
  const isComplete =
    name !== "" &&
    !isTaken &&
    (isWeb ? fields.url.trim() !== "" : fields.host.trim() !== "" && fields.called_ae !== "");
  const save = () => {
    const saved: PacsFields = isWeb
      ? { ...NEW_CONNECTION, ...fields, called_ae: fields.called_ae || "ANY-SCP", listen_port: null, name }
      : { ...fields, url: "", user: "", name };
    const sent = station.send({
      type: "save_pacs",
      connection: saved,
      password,
      replaces: connection?.name ?? null,
    });
    if (sent) onSent(name);
  };
  return (
    <Form
      className="pacs-form"
      onSubmit={(event) => {
        event.preventDefault();
        if (isComplete) save();
      }}
    >
      <h3>{connection === null ? "Add a connection" : `Edit ${connection.name}`}</h3>
      <Choice<Kind>
        name="Protocol"
        value={kind}
        choices={[
          { value: "dimse", label: "DICOM", words: "DICOM's own protocol: host, port and AE titles" },
          { value: "web", label: "DICOMweb", words: "A web address, often with user and password" },
        ]}
        onChange={setKind}
      />
      <Entry
        label="Name in this list"
        value={fields.name}
        onChange={(value) => change({ name: value })}
        testId="name"
      />
      {isTaken ? <p className="warning-text">Another connection has this name.</p> : null}
      {isWeb ? (
        <>
          <Entry
            label="Web address"
            value={fields.url}
            onChange={(url) => change({ url })}
            hint="https://pacs.example.org/dicom-web"
            testId="url"
          />
          <Entry label="User" value={fields.user} onChange={(user) => change({ user })} testId="user" />
          <Entry
            label="Password"
            type="password"
            value={password ?? ""}
            onChange={setPassword}
            hint={connection !== null && connection.user !== "" ? "unchanged" : ""}
            testId="password"
          />
          <p className="quiet small">
            The password is stored in the keyring of this system, or else in a file that only you can read.
            {fields.user !== "" && fields.url.startsWith("http:")
              ? " This address is not encrypted: the password can be read in the network. Use https if the PACS offers it."
              : ""}
          </p>
        </>
      ) : (
        <>
          <div className="pacs-pair">
            <Entry
              label="Host name or address"
              value={fields.host}
              onChange={(host) => change({ host })}
              hint="pacs.example.org"
              testId="host"
            />
            <NumberEntry
              label="Port"
              value={fields.port}
              onChange={(port) => change({ port: port ?? 104 })}
              testId="port"
            />
          </div>
          <div className="pacs-pair">
            <Entry
              label="AE title of the PACS"
              value={fields.called_ae}
              onChange={(called_ae) => change({ called_ae })}
              testId="called-ae"
            />
            <Entry
              label="AE title of this machine"
              value={fields.calling_ae}
              onChange={(calling_ae) => change({ calling_ae })}
              testId="calling-ae"
            />
          </div>
          <p className="quiet small">The administrator of the PACS enters the AE title of this machine there.</p>
          <NumberEntry
            label="Port for images (C-MOVE), only if the PACS needs it"
            value={fields.listen_port}
            onChange={(listen_port) => change({ listen_port })}
            testId="listen-port"
          />
          {fields.listen_port === null ? null : (
            <>
              <Entry
                label="Address for images (empty: the address from which this machine reaches the PACS)"
                value={fields.listen_host}
                onChange={(listen_host) => change({ listen_host })}
                testId="listen-host"
              />
              <p className="quiet small">
                The PACS sends the images in a second connection, which is not encrypted. The administrator enters this
                port and the address of this machine in the PACS, and opens the port in the firewall.
              </p>
            </>
          )}
          <label className="check">
            <input
              type="checkbox"
              checked={fields.tls}
              disabled={fields.listen_port !== null}
              onChange={(event) => change({ tls: event.target.checked })}
            />
            Encrypt the connection (TLS)
          </label>
        </>
      )}
      {isWeb || fields.tls ? (
        <Entry
          label="Certificate file (PEM), only if the system does not trust the PACS"
          value={fields.ca_file}
          onChange={(ca_file) => change({ ca_file })}
          testId="ca-file"
        />
      ) : null}
      <div className="dialog-actions">
        <Act label="Cancel" words="Do not save" onPress={onCancel} />
        <Button type="submit" className="button primary" isDisabled={!isComplete} data-testid="save-pacs">
          Save
        </Button>
      </div>
    </Form>
  );
}

interface EntryProps {
  label: string;
  value: string;
  onChange: (value: string) => void;
  testId: string;
  type?: "text" | "password";
  hint?: string;
}

function Entry({ label, value, onChange, testId, type = "text", hint = "" }: EntryProps) {
  return (
    <TextField value={value} onChange={onChange} type={type} maxLength={500}>
      <Label>{label}</Label>
      <Input data-testid={`pacs-${testId}`} placeholder={hint} spellCheck="false" autoComplete="off" />
    </TextField>
  );
}

interface NumberEntryProps {
  label: string;
  value: number | null;
  onChange: (value: number | null) => void;
  testId: string;
}

/** Render the field of a port; text that is not a port from 1 to 65535 stands for no port. */
function NumberEntry({ label, value, onChange, testId }: NumberEntryProps) {
  const [text, setText] = useState(value === null ? "" : String(value));
  return (
    <TextField
      value={text}
      inputMode="numeric"
      maxLength={5}
      onChange={(next) => {
        const digits = next.replace(/\D/g, "");
        setText(digits);
        const port = Number(digits);
        onChange(digits !== "" && port >= 1 && port <= 65535 ? port : null);
      }}
    >
      <Label>{label}</Label>
      <Input data-testid={`pacs-${testId}`} autoComplete="off" />
    </TextField>
  );
}
