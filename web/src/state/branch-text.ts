/** Texts of the list and the panel about a branch: title, confidence, and measurements with their errors. */

import type { BranchMeasures, RouteSpan } from "../wire/messages";
import { type BranchNode, type BranchTree, headOf, rowChildren } from "./airways";
import { fixed, mm, plural } from "./format";
import { placeText, type WithOrigin } from "./route";

/** Confidence below which the list marks a branch's name (`name`) or the branch itself (`airway`) as doubtful. */
const DOUBTFUL = { name: 0.6, airway: 0.5 } as const;

/** Sign after a branch name in the list, with its explanation. */
export interface Mark {
  readonly sign: string;
  readonly words: string;
}

const percent = (part: number): string => `${fixed(100 * part)} %`;

/** Return the marks of one branch for its doubts and anatomical variants. */
export function marksOf(node: BranchNode): readonly Mark[] {
  const { branch } = node;
  const marks: Mark[] = [];
  if (branch.name_confidence !== null && branch.name_confidence < DOUBTFUL.name) {
    marks.push({ sign: "?", words: `only ${percent(branch.name_confidence)} confidence in this name` });
  }
  if (branch.confidence !== null && branch.confidence < DOUBTFUL.airway) {
    marks.push({ sign: "~", words: `only ${percent(branch.confidence)} confidence that this is an airway` });
  }
  if (branch.variant !== null) marks.push({ sign: "v", words: `uncommon anatomy: ${branch.variant}` });
  return marks;
}

/** Return the marks of a row: for each kind of mark, the mark of the branch with the lowest confidence. */
export function marksOfRow(head: BranchNode): readonly Mark[] {
  const least = (of: (piece: BranchNode) => number | null): BranchNode =>
    head.row.reduce((a, b) => ((of(b) ?? 1) < (of(a) ?? 1) ? b : a), head);
  const name = marksOf(least(({ branch }) => branch.name_confidence)).filter(({ sign }) => sign === "?");
  const airway = marksOf(least(({ branch }) => branch.confidence)).filter(({ sign }) => sign === "~");
  const variants = head.row.flatMap((piece) => marksOf(piece).filter(({ sign }) => sign === "v"));
  return [...name, ...airway, ...variants.filter(({ words }, n) => variants.findIndex((v) => v.words === words) === n)];
}

/** Return whether the evidence for any part of a branch is weak. */
export const isDoubtful = ({ branch }: BranchNode): boolean =>
  branch.doubtful_mm > 0 || (branch.confidence !== null && branch.confidence < DOUBTFUL.airway);

/** Return the origin of a branch that the CT does not show, as text; null for a branch that the CT shows. */
export const kindText = (kind: BranchNode["branch"]["kind"]): string | null =>
  kind === "tracked" ? null : kind === "bridge" ? "bridge" : "drawn by hand";

/** Return the sentences that state the origin of a branch that the CT does not show; null for other branches. */
export function drawnText(node: BranchNode): string | null {
  const { kind } = node.branch;
  if (kind === "tracked") return null;
  if (kind === "bridge") return "Bridge across an obstruction. The CT shows no airway here.";
  const doubtful = node.branch.doubtful_mm;
  return doubtful > 0 ? `Drawn by hand. The CT shows no wall along ${mm(doubtful, 0)} of it.` : "Drawn by hand.";
}

/** Return the tooltip of a list row: names, measurements and doubts. */
export function tooltipOf(head: BranchNode): string {
  const { branch } = head;
  const lumen = calibreOf(head);
  const pieces = head.row.length;
  const facts = [
    head.longName === null ? head.label : `${head.label}, ${head.longName}`,
    `generation ${branch.generation}, ${mm(rowLengthMm(head), 0)} long${lumen === null ? "" : `, lumen ${lumen}\u202fmm`}`,
  ];
  if (pieces > 1) facts.push(`${plural(pieces, "piece", "pieces")} between side branches`);
  const drawn = drawnText(head);
  if (drawn !== null) facts.push(drawn);
  return [...facts, ...marksOfRow(head).map((mark) => mark.words)].join("\n");
}

/** Return the total length of the branches of a row, mm. */
export const rowLengthMm = (head: BranchNode): number => head.row.reduce((sum, piece) => sum + piece.lengthMm, 0);

/**
 * Return the range of lumen diameters in a row, "3.1\u20134.0" (mm), or one number if both ends have the same text;
 * null if no branch is measured.
 */
export function calibreOf(head: BranchNode): string | null {
  const lumens = head.row.map(lumenMm).filter((lumen) => lumen !== null);
  if (lumens.length === 0) return null;
  const least = fixed(Math.min(...lumens), 1);
  const most = fixed(Math.max(...lumens), 1);
  return least === most ? least : `${least}\u2013${most}`;
}

/** Return the measured lumen diameter of a branch, mm; null before the measurement, and for a branch drawn by hand. */
export const lumenMm = (node: BranchNode): number | null =>
  node.branch.kind === "manual" ? null : (node.measures?.lumen_mm ?? null);

/** Return the source of a branch's name as text; null for a branch without a name. */
export function nameText(node: BranchNode): string | null {
  const { name_from: from, name_confidence: sure } = node.branch;
  if (from === "person") return "named by hand";
  if (from === null) return null;
  return sure === null ? "automatic name" : `automatic name, ${percent(sure)} confidence`;
}

/** Return a value with its error as text, "6.1 ± 0.2"; null without a value. */
export const withError = (value: number | null, error: number | null, digits = 1): string | null =>
  value === null ? null : error === null ? mm(value, digits) : `${fixed(value, digits)} \u00b1 ${mm(error, digits)}`;

/** Narrowing in percent up to which a stenosis is within the normal variation of healthy airways. */
const STENOSIS_PERCENT = 20;

/** A measurement of a branch as text. */
export interface Fact {
  readonly term: string;
  readonly value: string;
  readonly warns?: boolean;
}

const EARLIER_METHOD =
  "an earlier version, which reads small airways too wide; any edit of the tree measures them again";

/** Return the measurements of a branch as texts, in the order of the panel. */
export function factsOf(node: BranchNode): readonly Fact[] {
  const measures = node.branch.kind === "manual" ? null : node.measures;
  const facts: (Fact | null)[] = [
    { term: "Generation", value: `${node.branch.generation} (trachea is 0)` },
    { term: "Length", value: mm(measures?.length_mm ?? node.lengthMm) },
  ];
  const { length } = node.row;
  if (length > 1) {
    const piece = 1 + node.row.indexOf(node);
    facts.push(
      { term: "Piece", value: `${piece} of ${length}, between side branches` },
      {
        term: "All pieces",
        value: `${mm(rowLengthMm(headOf(node)))} long, lumen ${calibreOf(headOf(node)) ?? "?"}\u202fmm`,
      },
    );
  }
  if (node.branch.kind === "manual") facts.push({ term: "Lumen", value: "not measured: drawn by hand" });
  else if (measures === null) facts.push({ term: "Lumen", value: "not measured yet" });
  else {
    facts.push(...measuredFacts(measures));
    if (measures.by_earlier_method) facts.push({ term: "Measured by", value: EARLIER_METHOD, warns: true });
  }
  return facts.filter((fact) => fact !== null);
}

function measuredFacts(measures: BranchMeasures): (Fact | null)[] {
  const fact = (term: string, value: string | null): Fact | null => (value === null ? null : { term, value });
  const narrowest = withError(measures.min_lumen_mm, measures.min_lumen_error_mm);
  const stenosis = measures.stenosis_percent;
  return [
    fact("Lumen", withError(measures.lumen_mm, measures.lumen_error_mm)),
    fact(
      "Narrowest",
      narrowest === null || measures.min_at_mm === null ? narrowest : `${narrowest} at ${mm(measures.min_at_mm, 0)}`,
    ),
    fact("Widest", withError(measures.max_lumen_mm, measures.max_lumen_error_mm)),
    fact("Wall", withError(measures.wall_mm, measures.wall_error_mm)),
    fact("Taper", measures.taper === null ? null : `${fixed(100 * measures.taper, 1)} mm per 100 mm`),
    stenosis === null
      ? null
      : {
          term: "Narrowing",
          value: `${fixed(stenosis)} %${
            measures.stenosis_error_percent === null ? "" : ` \u00b1 ${fixed(measures.stenosis_error_percent)}`
          }${measures.stenosis_at_mm === null ? "" : ` at ${mm(measures.stenosis_at_mm, 0)}`}`,
          warns: stenosis - (measures.stenosis_error_percent ?? 0) >= STENOSIS_PERCENT,
        },
    fact("Angle", measures.angle_deg === null ? null : `${fixed(measures.angle_deg)}\u00b0 to the parent branch`),
  ];
}

/** Result of the search in the airway list. */
export interface Filtered {
  /** IDs of the rows that match, and of their ancestors. */
  readonly shown: ReadonlySet<number>;
  readonly hits: readonly number[];
}

/**
 * Return the rows that match a search text, by the IDs of their first branches; null for an empty text. Words are
 * searched in names, long names and lobes. `g3` selects a generation, `?` doubtful branches, `bridge` and `by hand` the
 * branches drawn by the user.
 */
export function filterTree(tree: BranchTree, text: string): Filtered | null {
  const wanted = text.trim().toLowerCase();
  if (wanted === "") return null;
  const generation = /^g(\d+)$/.exec(wanted);
  const matches = (node: BranchNode): boolean => {
    if (generation !== null) return node.branch.generation === Number(generation[1]);
    if (wanted === "?") return marksOf(node).length > 0;
    const words = [node.label, node.longName ?? "", node.lobe ?? "", kindText(node.branch.kind) ?? ""];
    return words.some((part) => part.toLowerCase().includes(wanted));
  };
  const shown = new Set<number>();
  const hits: number[] = [];
  const visit = (node: BranchNode): boolean => {
    const own = node.row.some(matches);
    if (own) hits.push(node.branch.id);
    let any = own;
    for (const child of rowChildren(node)) any = visit(child) || any;
    if (any) shown.add(node.branch.id);
    return any;
  };
  visit(tree.root);
  return { shown, hits };
}

/** Return the match that Enter chooses: a branch with exactly this name, else the first in the list; null without one. */
export function bestHit(tree: BranchTree, { hits }: Filtered, text: string): number | null {
  const wanted = text.trim().toLowerCase();
  const exact = hits.find((id) => tree.byId.get(id)?.row.some((node) => node.label.toLowerCase() === wanted));
  return exact ?? hits[0] ?? null;
}

/** Properties of a route from which its warnings are made. */
type WithSpans = WithOrigin & { readonly spans: readonly Pick<RouteSpan, "kind" | "from_mm" | "to_mm">[] };

/** Return the warnings about parts of a route that the CT does not show, as text; null if there are none. */
export function routeDoubts(route: WithSpans): string | null {
  const parts = [drawnShare(route), bridgeText(route)].filter((part) => part !== null);
  return parts.length === 0 ? null : parts.map((part) => `${part}.`).join(" ");
}

/** Return the length of a route that was drawn by hand, as text; null if none was. */
export function drawnShare(route: WithSpans): string | null {
  const { spans } = route;
  const drawn = spans.filter((span) => span.kind === "manual");
  const total = drawn.reduce((sum, span) => sum + span.to_mm - span.from_mm, 0);
  const first = drawn[0];
  const last = spans.at(-1);
  if (first === undefined || last === undefined) return null;
  return `${fixed(total)} of ${mm(last.to_mm, 0)} drawn by hand, starting ${placeText(route, first.from_mm)}`;
}

/** Return the length of a route that is a bridge, as text; null if none is. */
function bridgeText(route: WithSpans): string | null {
  const bridges = route.spans.filter((span) => span.kind === "bridge");
  if (bridges.length === 0) return null;
  const total = bridges.reduce((sum, span) => sum + span.to_mm - span.from_mm, 0);
  const first = bridges[0];
  return `${mm(total)} of this route ${bridges.length === 1 ? "is a bridge across an obstruction" : `are ${bridges.length} bridges across obstructions`}${
    first === undefined ? "" : `, starting ${placeText(route, first.from_mm)}`
  }: the CT shows no airway there`;
}
