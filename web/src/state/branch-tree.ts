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
   * Diameter of the lumen found by the search, mm, used to sort and draw branches. The measured diameter is in
   * `measures`.
   */
  diameterMm: number;
  children: BranchNode[];
  /** The branches of the same bronchus, which side branches divide, from the trachea outwards: one row of the list. */
  row: readonly BranchNode[];
  /** Measurements; null until the branch is measured. */
  measures: BranchMeasures | null;
  /** The full name, such as "apical segment, RUL". */
  longName: string | null;
  lobe: BranchTitle["lobe"];
}

/** All centreline points in flat arrays, for searches on each mouse movement. */
export interface TreeIndex {
  readonly x: Float64Array;
  readonly y: Float64Array;
  readonly z: Float64Array;
  readonly radius: Float64Array;
  readonly along: Float64Array;
  readonly branch: Int32Array;
}

/** The airway tree with its index. */
export interface BranchTree {
  root: BranchNode;
  byId: ReadonlyMap<number, BranchNode>;
  index: TreeIndex;
  /** Places where the search could not follow an airway. */
  uncertain: readonly UncertainPlace[];
  /** Lobes and segments that were not found. */
  absent: readonly AbsentAirway[];
}
