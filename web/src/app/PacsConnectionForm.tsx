/** Form that adds or edits the connection to a PACS: DICOM (DIMSE) or DICOMweb. */

import { useState } from "react";
import { Button, FieldError, Form, Input, Label, TextField } from "react-aria-components";
import { NEW_CONNECTION, portOf } from "../state/pacs";
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
  const [port, setPort] = useState(String(fields.port));
  const [listenPort, setListenPort] = useState(fields.listen_port === null ? "" : String(fields.listen_port));
  const hasListenPort = listenPort.trim() !== "";
  const change = (part: Partial<PacsFields>) => setFields((before) => ({ ...before, ...part }));
  const name = fields.name.trim();
  const isTaken = names.includes(name) && name !== connection?.name;
  const isWeb = kind === "web";
  const isComplete =
    name !== "" &&
    !isTaken &&
    (isWeb
      ? fields.url.trim() !== ""
      : fields.host.trim() !== "" &&
        fields.called_ae !== "" &&
        portOf(port) !== null &&
        (!hasListenPort || portOf(listenPort) !== null));
  const save = () => {
    const saved: PacsFields = isWeb
      ? { ...NEW_CONNECTION, ...fields, called_ae: fields.called_ae || "ANY-SCP", listen_port: null, name }
      : { ...fields, port: portOf(port) ?? fields.port, listen_port: portOf(listenPort), url: "", user: "", name };
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
            <PortEntry label="Port" text={port} onChange={setPort} testId="port" />
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
          <PortEntry
            label="Port for images (C-MOVE), only if the PACS needs it"
            text={listenPort}
            onChange={setListenPort}
            testId="listen-port"
            isOptional
          />
          {!hasListenPort ? null : (
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
              // A checked box can always be cleared, because the server refuses both together.
              disabled={hasListenPort && !fields.tls}
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

interface PortEntryProps {
  label: string;
  text: string;
  onChange: (text: string) => void;
  testId: string;
  isOptional?: boolean;
}

/** Render the field of a port; a text that is not a port stays in the field, with the reason below it. */
function PortEntry({ label, text, onChange, testId, isOptional = false }: PortEntryProps) {
  const isInvalid = portOf(text) === null && !(isOptional && text.trim() === "");
  return (
    <TextField value={text} inputMode="numeric" maxLength={20} onChange={onChange} isInvalid={isInvalid}>
      <Label>{label}</Label>
      <Input data-testid={`pacs-${testId}`} autoComplete="off" />
      <FieldError data-testid={`pacs-${testId}-error`}>Enter a number from 1 to 65535.</FieldError>
    </TextField>
  );
}
