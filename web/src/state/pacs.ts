/** State of the PACS dialog: connections, test, search results and series; cleared when the dialog closes. */

import type {
  ClientMessage,
  PacsConnectionsMessage,
  PacsFields,
  PacsPreviewMessage,
  PacsProblemMessage,
  PacsSentMessage,
  PacsSeriesEntry,
  PacsSeriesMessage,
  PacsStudiesMessage,
  PacsStudyEntry,
  PacsTestMessage,
  ProgressMessage,
  ServerMessage,
} from "../wire/messages";
import { mm, plural } from "./format";

/** Answers about the PACS. Names of patients are stored here only while the dialog is open. */
export interface PacsState {
  readonly connections: PacsConnectionsMessage | null;
  readonly test: PacsTestMessage | null;
  readonly found: PacsStudiesMessage | null;
  readonly series: PacsSeriesMessage | null;
  readonly previews: Readonly<Record<string, PacsPreviewMessage>>;
  readonly sent: PacsSentMessage | null;
  readonly problem: PacsProblemMessage | null;
}

/** State before the first answer, and after the dialog was closed. */
export const NO_PACS: PacsState = {
  connections: null,
  test: null,
  found: null,
  series: null,
  previews: {},
  sent: null,
  problem: null,
};

/** Fields of a new connection. */
export const NEW_CONNECTION: PacsFields = {
  name: "",
  host: "",
  port: 104,
  called_ae: "",
  calling_ae: "CARINA",
  listen_port: null,
  listen_host: "",
  tls: false,
  url: "",
  user: "",
  ca_file: "",
};

/** Title of the server's job that sends a plan. */
const SEND_JOB = "sending the plan to the PACS";

/** Return whether a plan is being sent, from this window or from another one. */
export const isSending = (jobs: readonly Pick<ProgressMessage, "title">[]): boolean =>
  jobs.some(({ title }) => title === SEND_JOB);

/** Return whether an answer belongs to the open dialog; a closed dialog must not receive names of patients. */
const isForDialog = (message: ServerMessage): boolean =>
  message.type === "pacs_test" ||
  message.type === "pacs_studies" ||
  message.type === "pacs_series" ||
  message.type === "pacs_preview" ||
  (message.type === "pacs_problem" && message.task !== "settings" && message.task !== "send");

/** Return the state after an answer of the server; the same state for a message about something else. */
export function pacsAnswered(pacs: PacsState, message: ServerMessage, isOpen: boolean): PacsState {
  if (!isOpen && isForDialog(message)) return pacs;
  switch (message.type) {
    case "pacs_connections":
      return { ...pacs, connections: message, problem: null };
    case "pacs_test":
      return { ...pacs, test: message };
    case "pacs_studies":
      return { ...pacs, found: message };
    case "pacs_series":
      return { ...pacs, series: message };
    case "pacs_preview":
      return { ...pacs, previews: { ...pacs.previews, [message.series_uid]: message } };
    case "pacs_sent":
      return { ...pacs, sent: message };
    case "pacs_problem":
      return { ...pacs, problem: message };
    default:
      return pacs;
  }
}

/** Return the state after a request was sent: results that it replaces are cleared. */
export function pacsRequested(pacs: PacsState, message: ClientMessage): PacsState {
  switch (message.type) {
    case "test_pacs":
      return { ...pacs, test: null, problem: null };
    case "search_pacs":
      return { ...pacs, test: null, found: null, series: null, previews: {}, problem: null };
    case "ask_pacs_series":
      return { ...pacs, series: null, previews: {}, problem: null };
    case "get_pacs_series":
    case "save_pacs":
    case "remove_pacs":
    case "empty_pacs":
      return { ...pacs, problem: null };
    case "send_plan_to_pacs":
      return { ...pacs, sent: null, problem: null };
    case "stop_pacs":
      return pacsClosed(pacs);
    default:
      return pacs;
  }
}

/** Return the state without the answers for the dialog; the result of a sent plan stays, because it is shown elsewhere. */
export const pacsClosed = (pacs: PacsState): PacsState => ({
  ...NO_PACS,
  connections: pacs.connections,
  sent: pacs.sent,
  problem: pacs.problem?.task === "send" ? pacs.problem : null,
});

/** Return the port that a text states; null if the text is not a number from 1 to 65535. */
export function portOf(text: string): number | null {
  const digits = text.trim();
  const port = Number(digits);
  return /^\d+$/.test(digits) && port >= 1 && port <= 65535 ? port : null;
}

/** Return two dates of a search as the server reads them: one date, a range, or empty without a date. */
export function dateRange(from: string, to: string): string {
  if (from === "" && to === "") return "";
  const [first, last] = [from === "" ? to : from, to === "" ? from : to];
  return first === last ? first : first < last ? `${first}..${last}` : `${last}..${first}`;
}

/** Return the name of a patient as it is written: `MUSTER^ERIKA` as `MUSTER, ERIKA`. */
export const patientText = (name: string): string =>
  name
    .split("^")
    .map((part) => part.trim())
    .filter((part) => part !== "")
    .join(", ");

/** Return the facts of a study beside its patient: date, description, modalities and number of series. */
export function studyText(study: PacsStudyEntry): string {
  const facts = [
    study.date || "no date",
    study.description,
    study.modalities,
    study.num_series === null ? "" : plural(study.num_series, "series", "series"),
  ];
  return facts.filter((fact) => fact !== "").join(" \u00b7 ");
}

/** Return the facts of a series: number of images, thickness, kernel, phase and date, as far as they are known. */
export function pacsSeriesText(series: PacsSeriesEntry, preview: PacsPreviewMessage | undefined): string {
  const facts = [
    series.modality,
    series.num_images === null ? "" : plural(series.num_images, "image"),
    preview?.slice_mm == null ? "" : `${mm(preview.slice_mm, 2)} thick`,
    preview === undefined || preview.kernel === "" ? "" : `kernel ${preview.kernel}`,
    preview?.phase ?? "",
    preview?.scanned_on ?? "",
  ];
  return facts.filter((fact) => fact !== "").join(" \u00b7 ");
}

/** Return the address of a connection as text. */
export const addressText = (connection: PacsFields): string =>
  connection.url !== "" ? connection.url : `${connection.host}, port ${connection.port}, ${connection.called_ae}`;
