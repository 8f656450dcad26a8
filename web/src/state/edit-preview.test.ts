import { describe, expect, it } from "vitest";
import type { EditPreviewMessage, NoEvidenceMessage } from "../wire/messages";
import { doubtText, previewText, previewTool, runsOf } from "./edit-preview";

const LINE = {
  points_lps: [
    [0, 0, 0],
    [0, 0, -10],
    [0, 0, -20],
    [0, 0, -41],
  ],
  doubtful: [false, false, true],
  drawn: [false, false, true],
} as const;

function answer(change: Partial<EditPreviewMessage> = {}): EditPreviewMessage {
  return {
    type: "edit_preview",
    request_id: 1,
    tool: "add-branch",
    lps: [0, 0, -41],
    lines: [LINE],
    length_mm: 41,
    doubtful_mm: 21,
    has_evidence: false,
    problem: null,
    origin: { branch: "RB2", extends: false },
    renamed: null,
    ...change,
  };
}

const NBSP = "\u202f";

describe("preview of an edit", () => {
  it("Only the tools that add a branch, bridge, or move a selected fork have a preview.", () => {
    expect(previewTool("add", false)).toBe("add-branch");
    expect(previewTool("bridge", false)).toBe("bridge");
    expect([previewTool("fork", false), previewTool("fork", true)]).toEqual([null, "move-fork"]);
    expect(previewTool("cut", false)).toBeNull();
    expect(previewTool(null, false)).toBeNull();
  });

  it("runsOf splits a line into runs of airway and runs drawn by hand, and neighbouring runs share a point.", () => {
    expect(runsOf([LINE])).toEqual([
      { points: LINE.points_lps.slice(0, 3), drawn: false },
      { points: LINE.points_lps.slice(2), drawn: true },
    ]);
    expect(runsOf([])).toEqual([]);
    expect(runsOf([LINE, LINE]).length).toBe(4);
  });

  it("The text lists the first branches that the edit would rename.", () => {
    const seen = { has_evidence: true, doubtful_mm: 0 };
    const renamed = ["RB1", "RB2", "RB3", "RB4", "RB5", "RB6"].map((name) => `${name} becomes ${name}a`);
    expect(previewText({ answer: answer({ ...seen, renamed: renamed.slice(0, 1) }), stale: false }).lines).toEqual([
      `new branch from RB2, 41${NBSP}mm`,
      "RB1 becomes RB1a",
    ]);
    const lines = previewText({ answer: answer({ ...seen, renamed }), stale: false }).lines;
    expect(lines.length).toBe(6);
    expect(lines.at(-1)).toBe("2 more branches renamed");
  });

  it("The text states the origin and the length of a new branch, and the length without a visible airway wall.", () => {
    expect(previewText({ answer: answer(), stale: false })).toEqual({
      lines: [`new branch from RB2, 41${NBSP}mm`, `no wall along 21${NBSP}mm`],
      warns: true,
    });
    const seen = answer({ has_evidence: true, doubtful_mm: 0 });
    expect(previewText({ answer: seen, stale: false })).toEqual({
      lines: [`new branch from RB2, 41${NBSP}mm`],
      warns: false,
    });
    const extended = answer({ has_evidence: true, doubtful_mm: 0, origin: { branch: "RB2", extends: true } });
    expect(previewText({ answer: extended, stale: false }).lines).toEqual([`extends RB2 by 41${NBSP}mm`]);
    expect(previewText({ answer: answer({ tool: "bridge", doubtful_mm: 41 }), stale: false }).warns).toBe(true);
  });

  it("The text states that the search is running, or why the edit is impossible.", () => {
    expect(previewText({ answer: null, stale: true }).lines).toEqual(["searching for the airway\u2026"]);
    const none = answer({
      lines: [],
      length_mm: null,
      problem: "no airway leads from the tree to the point: there is tissue.",
    });
    expect(previewText({ answer: none, stale: false })).toEqual({
      lines: ["No airway leads from the tree to the point: there is tissue."],
      warns: true,
    });
  });
});

describe("doubtText", () => {
  const doubt = (change: Partial<NoEvidenceMessage> = {}): NoEvidenceMessage => ({
    type: "no_evidence",
    job_id: "job-1",
    code: "track.no-evidence",
    message: "",
    lps: [0, 0, -41],
    line: LINE,
    length_mm: 41,
    doubtful_mm: 21,
    ...change,
  });

  it("The question states along which length of the branch the CT shows no airway wall.", () => {
    expect(doubtText(doubt())).toBe(
      `The CT shows no airway wall along the last 21${NBSP}mm of this branch. Draw the airway there anyway?`,
    );
    const middle = doubt({ line: { ...LINE, doubtful: [false, true, false] }, doubtful_mm: 10 });
    expect(doubtText(middle)).toContain(`along 10${NBSP}mm of this branch.`);
    expect(doubtText(doubt({ length_mm: 21.3 }))).toContain("along this branch.");
  });
});
