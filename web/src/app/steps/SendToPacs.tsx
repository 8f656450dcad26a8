/** Controls that store the DICOM files of a plan in a PACS. */

import { useEffect, useState } from "react";
import { plural, sentence } from "../../state/format";
import { isSending } from "../../state/pacs";
import type { PacsFields, PacsProblemMessage, SendPlanToPacsMessage } from "../../wire/messages";
import { useApp, useStation } from "../context";
import { Act } from "../controls";
import { Icon } from "../icons";

type PlanFile = SendPlanToPacsMessage["files"][number];

const FILES: readonly [PlanFile, string][] = [
  ["seg", "SEG"],
  ["sr", "SR"],
  ["pdf", "PDF"],
];
const NONE: readonly PacsFields[] = [];

/**
 * Render the choice of files and connection, the button, and the result for this target; nothing in a browser on another
 * machine.
 */
export function SendToPacs({ targetId }: { targetId: string }) {
  const atMachine = useApp((state) => state.atMachine);
  return atMachine ? <Sending targetId={targetId} /> : null;
}

function Sending({ targetId }: { targetId: string }) {
  const station = useStation();
  const connections = useApp((state) => state.pacs.connections?.connections ?? NONE);
  const isKnown = useApp((state) => state.pacs.connections !== null);
  const sent = useApp((state) => (state.pacs.sent?.target_id === targetId ? state.pacs.sent : null));
  const problem = useApp((state) => problemOf(state.pacs.problem, targetId));
  const sending = useApp((state) => isSending(state.jobs));
  const [name, setName] = useState<string | null>(null);
  const [files, setFiles] = useState<readonly PlanFile[]>(["seg", "sr", "pdf"]);
  useEffect(() => {
    if (!isKnown) station.send({ type: "ask_pacs" });
  }, [station, isKnown]);
  const chosen = connections.find((one) => one.name === name) ?? connections[0] ?? null;
  if (!isKnown) return problem === null ? <p className="quiet">Reading the connections…</p> : <Problem {...problem} />;
  if (chosen === null) {
    return (
      <div className="row">
        <Act
          kind="quiet"
          label="Send to a PACS: add a connection"
          words="Enter the address of the PACS first"
          testId="add-pacs-for-plan"
          onPress={station.openPacs}
        />
      </div>
    );
  }
  return (
    <div className="send-to-pacs" data-testid="send-to-pacs">
      <h3>Send to a PACS</h3>
      <div className="row">
        {FILES.map(([kind, label]) => (
          <label key={kind} className="check">
            <input
              type="checkbox"
              checked={files.includes(kind)}
              onChange={(event) =>
                setFiles(event.target.checked ? [...files, kind] : files.filter((other) => other !== kind))
              }
            />
            {label}
          </label>
        ))}
      </div>
      <div className="row">
        {connections.length < 2 ? null : (
          <select value={chosen.name} aria-label="PACS connection" onChange={(event) => setName(event.target.value)}>
            {connections.map((one) => (
              <option key={one.name}>{one.name}</option>
            ))}
          </select>
        )}
        <Act
          label={sending ? "Sending\u2026" : `Send to ${chosen.name}`}
          words={
            sending ? "Wait until the plan is stored, or cancel it" : "Store these files in the PACS, beside the CT"
          }
          disabled={files.length === 0 || sending}
          testId="send-plan"
          onPress={() => station.send({ type: "send_plan_to_pacs", name: chosen.name, target_id: targetId, files })}
        />
      </div>
      <p className="quiet">
        Files that are sent always contain the name and number of the CT's patient, so that the PACS stores them with
        the CT.
      </p>
      {sent === null ? null : (
        <p className={sent.refused.length === 0 ? "" : "warning-text"} role="status" data-testid="sent-to-pacs">
          {plural(sent.num_stored, "file")} stored in {sent.name}.{sent.refused.map((words) => ` ${sentence(words)}.`)}
        </p>
      )}
      {problem === null ? null : <Problem {...problem} />}
    </div>
  );
}

/** Return a problem with the connections, or with sending the plan of a target; null for other problems. */
const problemOf = (problem: PacsProblemMessage | null, targetId: string): PacsProblemMessage | null =>
  problem?.task === "settings" || (problem?.task === "send" && problem.target_id === targetId) ? problem : null;

function Problem({ problem }: Pick<PacsProblemMessage, "problem">) {
  return (
    <p className="warning-text" role="alert" data-testid="send-problem">
      <Icon name="warning" /> {sentence(problem)}
    </p>
  );
}
