/** Preview of an edit before the click: its lines in the views, and the text beside the cursor. */

import type { AskEditPreviewMessage, EditLine, EditPreviewMessage, NoEvidenceMessage } from "../wire/messages";
import { mm, plural, sentence } from "./format";
import { firstSentences } from "./live-path";
import type { Armed } from "./tools";
import { asVec3, type Vec3 } from "./vec";

/** Name in the protocol of a tool with a preview. */
export type PreviewTool = AskEditPreviewMessage["tool"];
/** A preview request: a tool, and a point or a place in an airway view. */
export type PreviewQuestion = Omit<AskEditPreviewMessage, "type" | "request_id" | "with_names">;

/** The preview of the edit that a click at the cursor would make. */
export interface Preview {
  /** The server's latest answer; null until the first answer arrives. */
  readonly answer: EditPreviewMessage | null;
  /** Whether the cursor has moved since the answer's request, so that another answer is expected. */
  readonly stale: boolean;
}

/** Return the protocol's name of the active tool if it has a preview; null for other tools. */
export function previewTool(armed: Armed | null, forkHeld: boolean): PreviewTool | null {
  if (armed === "add") return "add-branch";
  if (armed === "bridge") return "bridge";
  return armed === "fork" && forkHeld ? "move-fork" : null;
}

/** A part of a preview line that either is all airway or is all drawn by hand. */
export interface PreviewRun {
  readonly points: readonly Vec3[];
  readonly drawn: boolean;
}

/** Split preview lines into solid runs (airway) and dashed runs (drawn by hand); neighbouring runs share a point. */
export function runsOf(lines: readonly EditLine[]): readonly PreviewRun[] {
  const runs: { points: Vec3[]; drawn: boolean }[] = [];
  for (const line of lines) {
    let current: { points: Vec3[]; drawn: boolean } | null = null;
    line.drawn.forEach((drawn, n) => {
      const [from, to] = [line.points_lps[n], line.points_lps[n + 1]];
      if (from === undefined || to === undefined) return;
      if (current === null || current.drawn !== drawn) {
        current = { points: [asVec3(from)], drawn };
        runs.push(current);
      }
      current.points.push(asVec3(to));
    });
  }
  return runs;
}

/**
 * Return the text lines beside the cursor. `warns` is true if the CT does not show the new branch, or if the edit is
 * impossible.
 */
export function previewText({ answer }: Preview): { lines: readonly string[]; warns: boolean } {
  if (answer === null) return { lines: ["searching for the airway\u2026"], warns: false };
  if (answer.problem !== null || answer.length_mm === null) {
    return { lines: [firstSentences(sentence(answer.problem ?? "no branch can be added here"))], warns: true };
  }
  const doubtful = answer.doubtful_mm ?? 0;
  const renamed = renamedLines(answer.renamed ?? []);
  switch (answer.tool) {
    case "add-branch": {
      const added = addedText(answer.origin, mm(answer.length_mm, 0));
      return answer.has_evidence
        ? { lines: [added, ...renamed], warns: false }
        : { lines: [added, `no wall along ${mm(doubtful, 0)}`, ...renamed], warns: true };
    }
    case "bridge":
      return { lines: [`bridge, ${mm(doubtful, 0)}`, "the CT shows no airway here", ...renamed], warns: true };
    case "move-fork":
      return { lines: ["move the fork here", ...renamed], warns: false };
  }
}

/** Maximum number of renamed branches beside the cursor. */
const MAX_RENAMED = 4;

/** Return a line for each branch that the edit would rename. */
function renamedLines(renamed: readonly string[]): readonly string[] {
  const lines = renamed.slice(0, MAX_RENAMED);
  const more = renamed.length - MAX_RENAMED;
  return more > 0 ? [...lines, `${plural(more, "more branch", "more branches")} renamed`] : lines;
}

/** Return the text of a new branch: its origin and its length. */
function addedText(origin: EditPreviewMessage["origin"], length: string): string {
  if (origin === null) return `new branch, ${length}`;
  return origin.extends ? `extends ${origin.branch} by ${length}` : `new branch from ${origin.branch}, ${length}`;
}

/** Return the question whether to draw by hand a branch that the CT does not show. */
export function doubtText({ line, doubtful_mm, length_mm }: NoEvidenceMessage): string {
  const last = line.doubtful.indexOf(true);
  const tail = last >= 0 && line.doubtful.slice(last).every((doubtful) => doubtful);
  const all = length_mm - doubtful_mm < 1;
  const where = all
    ? "this branch"
    : tail
      ? `the last ${mm(doubtful_mm, 0)} of this branch`
      : `${mm(doubtful_mm, 0)} of this branch`;
  return `The CT shows no airway wall along ${where}. Draw the airway there anyway?`;
}
