/** Types of the airway tree: branches with names and measurements, and the index of their centrelines. */

import type { AbsentAirway, BranchMeasures, BranchTitle, TreeBranch, UncertainPlace } from "../wire/messages";

/** Body side of a branch relative to the carina. */
export type Side = "right" | "left" | "middle";

/** A branch of the airway tree. */
export interface BranchNode {
  branch: TreeBranch;
  label: string;
  side: Side;
  lengthMm: number;
  /**
   * Diameter of the lumen that the search found, mm. It is used to sort and draw branches; the measured diameter is in
   * `measures`.
   */
  diameterMm: number;
  children: BranchNode[];
  /**
   * The branches of one bronchus, which its side branches divide, from the trachea outwards. The list shows them as one
   * row.
   */
  row: readonly BranchNode[];
  /** Measurements of the branch; null until it is measured. */
  measures: BranchMeasures | null;
  /** Full anatomical name, such as "apical segment, RUL"; null without one. */
  longName: string | null;
  lobe: BranchTitle["lobe"];
}

/** All centreline points of the tree in flat arrays, for fast searches at each cursor movement. */
export interface TreeIndex {
  readonly x: Float64Array;
  readonly y: Float64Array;
  readonly z: Float64Array;
  readonly radius: Float64Array;
  readonly along: Float64Array;
  readonly branch: Int32Array;
}

/** The airway tree with the search index of its centrelines. */
export interface BranchTree {
  root: BranchNode;
  byId: ReadonlyMap<number, BranchNode>;
  index: TreeIndex;
  /** Places where the search could not follow an airway. */
  uncertain: readonly UncertainPlace[];
  /** Lobes and segments without a detected bronchus. */
  absent: readonly AbsentAirway[];
}
