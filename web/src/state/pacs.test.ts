import { describe, expect, it } from "vitest";
import type { PacsPreviewMessage, PacsProblemMessage, PacsSeriesEntry, ServerMessage } from "../wire/messages";
import {
  dateRange,
  isSending,
  NO_PACS,
  pacsAnswered,
  pacsClosed,
  pacsRequested,
  pacsSeriesText,
  patientText,
  portOf,
  studyText,
} from "./pacs";

const STUDY = {
  study_uid: "1.2",
  patient_name: "MUSTER^ERIKA",
  patient_id: "17",
  date: "2026-11-03",
  description: "Chest",
  modalities: "CT",
  num_series: 2,
};
const FOUND: ServerMessage = { type: "pacs_studies", name: "hospital", studies: [STUDY], has_more: false };

const PREVIEW: ServerMessage = {
  type: "pacs_preview",
  series_uid: "1.2",
  slice_mm: null,
  kernel: "",
  phase: "",
  scanned_on: null,
  picture: null,
};
const SENT: ServerMessage = { type: "pacs_sent", name: "hospital", target_id: "target-1", num_stored: 1, refused: [] };
const problem = (task: PacsProblemMessage["task"]): PacsProblemMessage => ({
  type: "pacs_problem",
  task,
  code: "pacs.offline",
  problem: "off",
  target_id: task === "send" ? "target-1" : null,
});

describe("state of the PACS dialog", () => {
  it.each([
    [FOUND],
    [{ type: "pacs_series", name: "a", study_uid: "1", series: [], preselected: null, reason: "" } as const],
    [PREVIEW],
    [{ type: "pacs_test", name: "a", passed: true, steps: [] } as const],
    [problem("search")],
    [problem("series")],
  ])("ignores an answer that arrives while the dialog is closed: %j", (message) => {
    expect(pacsAnswered(NO_PACS, message, false)).toBe(NO_PACS);
    expect(pacsAnswered(NO_PACS, message, true)).not.toEqual(NO_PACS);
  });

  it("stores the result of a sent plan after the dialog was closed", () => {
    expect(pacsClosed(pacsAnswered(NO_PACS, SENT, false)).sent).toEqual(SENT);
    expect(pacsClosed(pacsAnswered(NO_PACS, problem("send"), false)).problem).toEqual(problem("send"));
    expect(pacsClosed(pacsAnswered(NO_PACS, problem("get"), true)).problem).toBeNull();
  });

  it("recognises the job that sends a plan", () => {
    expect(isSending([{ title: "retrieving the series" }])).toBe(false);
    expect(isSending([{ title: "sending the plan to the PACS" }])).toBe(true);
  });

  it("contains no patient after the dialog was closed", () => {
    const open = pacsAnswered(NO_PACS, FOUND, true);
    expect(JSON.stringify(open)).toContain("MUSTER");
    expect(JSON.stringify(pacsRequested(open, { type: "stop_pacs" }))).not.toContain("MUSTER");
  });

  it("shows no result of an earlier search while another runs", () => {
    const search = { type: "search_pacs", name: "a", patient_name: "", patient_id: "9", date: "" } as const;
    expect(pacsRequested(pacsAnswered(NO_PACS, FOUND, true), search).found).toBeNull();
  });

  it("clears a problem when the request is repeated", () => {
    const failed = pacsAnswered(NO_PACS, problem("test"), true);
    expect(failed.problem?.problem).toBe("off");
    expect(pacsRequested(failed, { type: "test_pacs", name: "a" }).problem).toBeNull();
  });
});

describe("port of a connection", () => {
  it.each([
    ["104", 104],
    [" 11112 ", 11112],
    ["65535", 65535],
    ["65536", null],
    ["70000", null],
    ["0", null],
    ["", null],
    ["1o4", null],
    ["-1", null],
    ["1e3", null],
    ["10.5", null],
  ])("reads %j as %j", (text, port) => {
    expect(portOf(text)).toBe(port);
  });
});

describe("texts of the PACS dialog", () => {
  it.each([
    ["", "", ""],
    ["2026-11-03", "", "2026-11-03"],
    ["", "2026-11-03", "2026-11-03"],
    ["2026-11-01", "2026-11-30", "2026-11-01..2026-11-30"],
    ["2026-11-30", "2026-11-01", "2026-11-01..2026-11-30"],
  ])("writes the dates %s and %s as %s", (from, to, expected) => {
    expect(dateRange(from, to)).toBe(expected);
  });

  it("names patient, study and series", () => {
    expect(patientText("MUSTER^ERIKA^^Dr")).toBe("MUSTER, ERIKA, Dr");
    expect(studyText(STUDY)).toBe("2026-11-03 \u00b7 Chest \u00b7 CT \u00b7 2 series");
    const series: PacsSeriesEntry = {
      series_uid: "1.2.3",
      modality: "CT",
      description: "Thorax",
      number: 2,
      num_images: 312,
    };
    expect(pacsSeriesText(series, undefined)).toBe("CT \u00b7 312 images");
    const preview: PacsPreviewMessage = {
      type: "pacs_preview",
      series_uid: "1.2.3",
      slice_mm: 1,
      kernel: "b70f",
      phase: "",
      scanned_on: "2026-11-03",
      picture: null,
    };
    expect(pacsSeriesText(series, preview)).toBe(
      "CT \u00b7 312 images \u00b7 1.00\u202fmm thick \u00b7 kernel b70f \u00b7 2026-11-03",
    );
  });
});
