import { describe, expect, it } from "vitest";
import type { PacsPreviewMessage, PacsSeriesEntry, ServerMessage } from "../wire/messages";
import { dateRange, NO_PACS, pacsAnswered, pacsRequested, pacsSeriesText, patientText, studyText } from "./pacs";

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

describe("state of the PACS dialog", () => {
  it("contains no patient after the dialog was closed", () => {
    const open = pacsAnswered(NO_PACS, FOUND);
    expect(JSON.stringify(open)).toContain("MUSTER");
    expect(JSON.stringify(pacsRequested(open, { type: "stop_pacs" }))).not.toContain("MUSTER");
  });

  it("shows no result of an earlier search while another runs", () => {
    const search = { type: "search_pacs", name: "a", patient_name: "", patient_id: "9", date: "" } as const;
    expect(pacsRequested(pacsAnswered(NO_PACS, FOUND), search).found).toBeNull();
  });

  it("clears a problem when the request is repeated", () => {
    const failed = pacsAnswered(NO_PACS, { type: "pacs_problem", task: "test", code: "pacs.offline", problem: "off" });
    expect(failed.problem?.problem).toBe("off");
    expect(pacsRequested(failed, { type: "test_pacs", name: "a" }).problem).toBeNull();
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
