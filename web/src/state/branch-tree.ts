/** The airway tree as values: branches with what is said of them, and their centrelines in flat lists. */

import type { AbsentAirway, BranchMeasures, BranchTitle, TreeBranch, UncertainPlace } from "../wire/messages";

export type Side = "right" | "left" | "middle";

export interface BranchNode {
  branch: TreeBranch;
  label: string;
  side: Side;
  lengthMm: number;
  /** Of the lumen that the search found, mm: to order and draw branches. The measured diameter is in `measures`. */
  diameterMm: number;
  children: BranchNode[];
  /** The pieces of its bronchus, which side branches cut in two, from the trachea outwards: one row of the list. */
  row: readonly BranchNode[];
  /** Null until it was measured. */
  measures: BranchMeasures | null;
  /** The name in full, such as "apical segment, RUL". */
  longName: string | null;
  lobe: BranchTitle["lobe"];
}

/** All centreline points in flat lists, for questions that come with each movement of the mouse. */
export interface TreeIndex {
  readonly x: Float64Array;
  readonly y: Float64Array;
  readonly z: Float64Array;
  readonly radius: Float64Array;
  readonly along: Float64Array;
  readonly branch: Int32Array;
}

export interface BranchTree {
  root: BranchNode;
  byId: ReadonlyMap<number, BranchNode>;
  index: TreeIndex;
  /** What could not be followed. */
  uncertain: readonly UncertainPlace[];
  /** Lobes and segments that were not found. */
  absent: readonly AbsentAirway[];
}
