/** Map of the airways on the score screen: branches of segments coloured by the time at which the segment was seen. */

import type { FlightScore, ScoreMoment, SegmentVisit } from "../wire/messages";
import type { BranchNode, BranchTree } from "./branch-tree";

/** Line of a branch on the map. */
export interface MapLine {
  readonly id: number;
  /** Points in the frontal projection: to the patient's left, and towards the feet, mm. */
  readonly points: readonly { readonly x: number; readonly y: number }[];
  /** Segment of the branch; null for a branch above the segments. */
  readonly segment: SegmentVisit | null;
  /** Share of the procedure time at which the segment was seen, 0 to 1; null if it was not seen. */
  readonly at: number | null;
}

/** Maximum generation of the branches that the map of the score draws. */
const MAX_GENERATION = 5;

/** Return the lines of the map: the branches of low generation, those of segments with the time of their view. */
export function mapLines(score: FlightScore, tree: BranchTree): readonly MapLine[] {
  const lengthS = Math.max(score.clock_end_s - score.clock_start_s, 1e-6);
  const bySegment = new Map(score.segments.flatMap((one) => one.branch_ids.map((id) => [id, one] as const)));
  const segmentOf = (node: BranchNode): SegmentVisit | null => {
    let at: BranchNode | undefined = node;
    while (at !== undefined) {
      const found = bySegment.get(at.branch.id);
      if (found !== undefined) return found;
      at = at.branch.parent === null ? undefined : tree.byId.get(at.branch.parent);
    }
    return null;
  };
  return [...tree.byId.values()]
    .filter(({ branch }) => branch.generation <= MAX_GENERATION)
    .map((node) => {
      const segment = segmentOf(node);
      const seenS = segment?.seen_s ?? null;
      return {
        id: node.branch.id,
        points: node.branch.points.map((point) => ({ x: point[0] ?? 0, y: -(point[2] ?? 0) })),
        segment,
        at: seenS === null ? null : Math.min(Math.max((seenS - score.clock_start_s) / lengthS, 0), 1),
      };
    });
}

/** Return the box that contains all lines, with a margin: left, top, width and height, mm. */
export function mapBox(lines: readonly MapLine[], margin = 4): readonly [number, number, number, number] {
  const points = lines.flatMap((line) => line.points);
  if (points.length === 0) return [0, 0, 1, 1];
  const [left, right] = [Math.min(...points.map(({ x }) => x)), Math.max(...points.map(({ x }) => x))];
  const [top, bottom] = [Math.min(...points.map(({ y }) => y)), Math.max(...points.map(({ y }) => y))];
  return [left - margin, top - margin, right - left + 2 * margin, bottom - top + 2 * margin];
}

/** Return the colour of a segment that was seen at a share of the procedure time: blue at its start, orange at its end. */
export const timeColour = (at: number): string => `hsl(${Math.round(200 - 165 * at)} 85% 55%)`;

/** Return in one line when and how a segment was seen. */
export function visitText({ name, seen_s: seenS, entered }: SegmentVisit, clock: (s: number) => string): string {
  return seenS === null
    ? `${name}: not seen`
    : `${name}: ${entered ? "entered" : "seen from outside"}, ${clock(seenS)}`;
}

/** Moment of a flight that a button on the timeline replays. */
export interface ReplayMark extends ScoreMoment {
  /** Number of a fault, or letter of a high-error event. */
  readonly label: string;
  readonly isHighError: boolean;
}

/** Return the buttons of the timeline: the faults with numbers, then the high-error events with letters. */
export function replayMarks({ moments, comparison_moments }: FlightScore): readonly ReplayMark[] {
  return [
    ...moments.map((one, n) => ({ ...one, label: String(n + 1), isHighError: false })),
    ...comparison_moments.map((one, n) => ({ ...one, label: String.fromCharCode(65 + n), isHighError: true })),
  ];
}

/** Return positions on a line, 0 to 1, moved apart so that neighbours differ by at least `least`; in the given order. */
export function spread(shares: readonly number[], least: number): readonly number[] {
  const order = shares.map((_, n) => n).sort((a, b) => (shares[a] ?? 0) - (shares[b] ?? 0));
  const found = [...shares];
  let at = -least;
  for (const n of order) found[n] = at = Math.max(found[n] ?? 0, at + least);
  let most = 1;
  for (const n of order.reverse()) {
    found[n] = Math.min(found[n] ?? 0, most);
    most = found[n] - least;
  }
  return found;
}
