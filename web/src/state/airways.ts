/** Airway tree for display: rows of the list, body side of each branch, and the branches that continue from a fork. */

import {
  type AbsentAirway,
  type BranchMeasures,
  type BranchTitle,
  type RouteInfo,
  STRAIGHT_AHEAD,
  type TreeBranch,
  type TreeDocument,
  type TurnOpening,
  type UncertainPlace,
} from "../wire/messages";
import type { BranchNode, BranchTree, Side } from "./branch-tree";
import { clockHour } from "./letters";
import { indexOf } from "./tree-index";
import { asVec3, type Camera, distance, dot, sub, type Vec3 } from "./vec";

export type { BranchNode, BranchTree, Side } from "./branch-tree";

/** Optional data that the server sends together with a tree. */
export interface TreeExtras {
  readonly titles?: readonly BranchTitle[];
  readonly measures?: readonly BranchMeasures[] | null;
  readonly uncertain?: readonly UncertainPlace[];
  readonly absent?: readonly AbsentAirway[];
}

function lengthOf(branch: TreeBranch): number {
  let sum = 0;
  for (let index = 1; index < branch.points.length; index += 1) {
    const a = branch.points[index - 1];
    const b = branch.points[index];
    if (a !== undefined && b !== undefined) sum += distance(asVec3(a), asVec3(b));
  }
  return sum;
}

function medianDiameter(branch: TreeBranch): number {
  const sorted = [...branch.radius].sort((a, b) => a - b);
  return 2 * (sorted[sorted.length >> 1] ?? 0);
}

function tip(branch: TreeBranch): Vec3 | null {
  const last = branch.points.at(-1);
  return last === undefined ? null : asVec3(last);
}

/**
 * Build the tree and its list rows; return null if the tree has no valid root branch.
 *
 * The side comes from geometry, not from names, and not from the first fork: a root in the middle of the trachea has
 * one branch that leads up and one that leads down. The carina is the fork that best separates tips on the right from
 * tips on the left (LPS: the patient's left is +x); branches that are not below the carina have the side "middle".
 */
export function buildTree(given: TreeDocument, extras: TreeExtras = {}): BranchTree | null {
  const measured = new Map(extras.measures?.map((entry) => [entry.branch_id, entry]) ?? []);
  const titles = new Map(extras.titles?.map((entry) => [entry.branch_id, entry]) ?? []);
  const branches = new Map(given.branches.map((branch) => [branch.id, branch]));
  const rootBranch = branches.get(given.root);
  if (rootBranch === undefined) return null;
  const byId = new Map<number, BranchNode>();
  const build = (branch: TreeBranch): BranchNode => {
    // Ignore an anatomical name on a branch drawn by hand, which is not an anatomical bronchus; only the user can name
    // it.
    const unnamed = branch.kind === "manual" && branch.name_from !== "person";
    const title = unnamed ? undefined : titles.get(branch.id);
    const node: BranchNode = {
      branch: unnamed ? { ...branch, name: null, name_from: null, name_confidence: null, variant: null } : branch,
      label: (unnamed ? null : branch.name) ?? (branch.parent === null ? "First branch" : `Branch ${branch.id}`),
      side: "middle",
      lengthMm: lengthOf(branch),
      diameterMm: medianDiameter(branch),
      children: [],
      row: [],
      measures: measured.get(branch.id) ?? null,
      longName: title?.long ?? null,
      lobe: title?.lobe ?? null,
    };
    // Store the node before the recursion, so that a malformed tree with a cycle does not recurse without end.
    byId.set(branch.id, node);
    for (const id of branch.children) {
      const child = branches.get(id);
      if (child !== undefined && !byId.has(id)) node.children.push(build(child));
    }
    return node;
  };
  const root = build(rootBranch);
  giveRows(root, [root]);
  let best: { worth: number; sides: [BranchNode, Side][] } = { worth: 0, sides: [] };
  for (const node of byId.values()) {
    const sides = node.children.map((child) => ({ child, ...leaning(node, child) }));
    const right = Math.max(0, ...sides.map(({ meanX, tips }) => (meanX < 0 ? -meanX * tips : 0)));
    const left = Math.max(0, ...sides.map(({ meanX, tips }) => (meanX > 0 ? meanX * tips : 0)));
    // Use the smaller of the two sides: at a fork within one lung, one side has few tips, and they are close to the
    // fork.
    const worth = Math.min(right, left);
    if (worth > best.worth) {
      best = { worth, sides: sides.map(({ child, meanX }) => [child, meanX < 0 ? "right" : "left"]) };
    }
  }
  for (const [child, side] of best.sides) giveSide(child, side);
  return { root, byId, index: indexOf(byId.values()), uncertain: extras.uncertain ?? [], absent: extras.absent ?? [] };
}

/**
 * Assign branches to rows. A branch continues its parent's row if no other child of the parent has the same name, name
 * source and kind.
 */
function giveRows(node: BranchNode, row: BranchNode[]): void {
  node.row = row;
  const onward = node.children.filter((child) => continuesIn(node, child));
  for (const child of node.children) {
    if (onward.length === 1 && child === onward[0]) {
      row.push(child);
      giveRows(child, row);
    } else giveRows(child, [child]);
  }
}

const continuesIn = ({ branch: above }: BranchNode, { branch }: BranchNode): boolean =>
  above.name !== null &&
  branch.name === above.name &&
  branch.name_from === above.name_from &&
  branch.kind === above.kind;

/** Return the first branch of the bronchus that a row of the branch list shows. */
export const headOf = (node: BranchNode): BranchNode => node.row[0] ?? node;

/**
 * Return the first branch of each child row of a row in the branch list. A child row begins with a child that does not
 * continue the row of its parent.
 */
export const rowChildren = (head: BranchNode): BranchNode[] =>
  head.row.flatMap((piece) => piece.children.filter((child) => headOf(child) === child));

/**
 * Return the number of tips below a child of a fork, and their mean distance from the fork towards the patient's left,
 * mm.
 */
function leaning(node: BranchNode, child: BranchNode): { meanX: number; tips: number } {
  const fork = tip(node.branch);
  const tips = tipsBelow(child);
  if (fork === null || tips.length === 0) return { meanX: 0, tips: 0 };
  return { meanX: tips.reduce((sum, point) => sum + point[0] - fork[0], 0) / tips.length, tips: tips.length };
}

function tipsBelow(node: BranchNode): Vec3[] {
  if (node.children.length > 0) return node.children.flatMap(tipsBelow);
  const end = tip(node.branch);
  return end === null ? [] : [end];
}

function giveSide(node: BranchNode, side: Side): void {
  node.side = side;
  for (const child of node.children) giveSide(child, side);
}

/** Return the leaf below a branch that is reached by taking the child of largest diameter at each fork. */
export function mainLeaf(node: BranchNode): BranchNode {
  let leaf = node;
  const seen = new Set<number>();
  while (leaf.children.length > 0 && !seen.has(leaf.branch.id)) {
    seen.add(leaf.branch.id);
    leaf = leaf.children.reduce((a, b) => (b.diameterMm > a.diameterMm ? b : a));
  }
  return leaf;
}

/** A branch that continues from a fork, with the position of its opening in the airway view. */
export interface OnwardBranch {
  node: BranchNode;
  /** Whether the branch is on the selected route. */
  chosen: boolean;
  /** Clock hour of the branch's opening around the middle of the view; null if no hour is given (`noHour`). */
  hour: number | null;
  /** Text instead of an hour: the opening is in the middle of the view or hidden, or its hour is not reliable. */
  noHour: "straight ahead" | "not in view" | "no clock hour" | null;
  /**
   * Horizontal position of the opening in the view, by which the branches are sorted: angle in rad, positive to the
   * right.
   */
  across: number;
}

/**
 * Limits, mm, of the distance from a child's beginning to the point that represents its opening. The distance is one
 * diameter of the child, so that the point is past the spur and before the next bend.
 */
const OPENING_MM = { least: 4, most: 10 };
/** Maximum number of successive branches in which the point that represents an opening is searched. */
const OPENING_DEPTH = 4;
/** A branch at a fork of the planned route, with its opening in the list of turns. */
export interface TurnBranch {
  node: BranchNode;
  opening: TurnOpening;
}

/** The openings of a turn in the list of turns. */
export interface TurnBranches {
  ways: readonly TurnBranch[];
  /** Whether the clock hour of the first opening is not reliable. */
  doubtful: boolean;
  /** Whether the camera is at the viewpoint of the turn, where the listed directions are valid. */
  atViewpoint: boolean;
}

/**
 * Return the branches that continue from the end of a branch, from left to right in the view of the camera.
 *
 * The branches and the middles of their openings are those of the list of turns (`listed`). Without a list, the opening
 * of a child is represented by a point of its centreline.
 */
export function onwardBranches(
  node: BranchNode,
  camera: Camera,
  route: Pick<RouteInfo, "spans"> | null,
  listed: TurnBranches | null = null,
): OnwardBranch[] {
  const fork = tip(node.branch);
  if (fork === null) return [];
  const onRoute = new Set(route?.spans.map((span) => span.branch_id) ?? []);
  const ways = listed?.ways ?? node.children.map((child) => ({ node: child, opening: null }));
  const openings = ways.map((way) => {
    const middle = way.opening?.middle_lps ?? null;
    const seen = sub(middle === null ? openingOf(way.node, fork) : asVec3(middle), camera.position);
    return { ...way, ...anglesOf(seen, camera) };
  });
  const hours = openings.map(({ x, y }) => clockHour(Math.atan2(x, -y)));
  const offDeg = openings.map(({ x, y }) => (Math.hypot(x, y) * 180) / Math.PI);
  const nearest = Math.min(...offDeg);
  const middle = offDeg.indexOf(nearest);
  const others = offDeg.filter((_, index) => index !== middle);
  const ahead =
    others.length > 0 &&
    nearest <= (openings[middle]?.opening?.ahead_deg ?? STRAIGHT_AHEAD.most_deg) &&
    others.every((off) => off >= STRAIGHT_AHEAD.times * nearest);
  // The clock hour does not distinguish openings with the same hour.
  const isShared = (index: number): boolean =>
    hours.some((hour, other) => other !== index && !(ahead && other === middle) && hour === hours[index]);
  return openings
    .map(({ node: child, opening, x }, index) => {
      const inMiddle = listed?.atViewpoint ? opening?.straight_ahead === true : ahead && index === middle;
      const isUnsure = (index === 0 && listed?.doubtful) || (!listed?.atViewpoint && !inMiddle && isShared(index));
      const noHour: OnwardBranch["noHour"] =
        opening?.in_view === false ? "not in view" : isUnsure ? "no clock hour" : inMiddle ? "straight ahead" : null;
      return {
        node: child,
        chosen: onRoute.has(child.branch.id),
        hour: noHour === null ? (hours[index] ?? null) : null,
        noHour,
        across: x,
      };
    })
    .sort((a, b) => a.across - b.across);
}

/** Return the angles in rad to the right and down of a direction, as in an equidistant picture of the camera. */
function anglesOf(direction: Vec3, camera: Camera): { x: number; y: number } {
  const right = dot(direction, camera.right);
  const down = dot(direction, camera.down);
  const across = Math.hypot(right, down);
  const scale = across > 0 ? Math.atan2(across, dot(direction, camera.forward)) / across : 0;
  return { x: right * scale, y: down * scale };
}

/**
 * Return the clock hour of a child's opening around the middle of the view, and its angle from the middle; null if the
 * branch has no end.
 */
export function openingDirection(
  { branch }: BranchNode,
  child: BranchNode,
  camera: Camera,
): { readonly hour: number; readonly offDeg: number } | null {
  const fork = tip(branch);
  if (fork === null) return null;
  const { x, y } = anglesOf(sub(openingOf(child, fork), camera.position), camera);
  return { hour: clockHour(Math.atan2(x, -y)), offDeg: (Math.hypot(x, y) * 180) / Math.PI };
}

/** Return a point about one diameter beyond the fork, in a child or, if the child is shorter, in its widest child. */
function openingOf(child: BranchNode, fork: Vec3): Vec3 {
  const far = Math.min(Math.max(child.diameterMm, OPENING_MM.least), OPENING_MM.most);
  let end = fork;
  for (let node: BranchNode | undefined = child, depth = 0; node !== undefined && depth < OPENING_DEPTH; depth += 1) {
    const inside = node.branch.points.map((point) => asVec3(point)).find((point) => distance(point, fork) >= far);
    if (inside !== undefined) return inside;
    end = tip(node.branch) ?? end;
    node = node.children.reduce<BranchNode | undefined>(
      (a, b) => (a === undefined || b.diameterMm > a.diameterMm ? b : a),
      undefined,
    );
  }
  return end;
}

/**
 * Return the branch to the left (-1) or right (+1) of the branch on the route; null if that branch is the outermost.
 */
export function neighbourBranch(ways: readonly OnwardBranch[], step: -1 | 1): OnwardBranch | null {
  const chosen = ways.findIndex((way) => way.chosen);
  if (chosen < 0) return (step < 0 ? ways[0] : ways.at(-1)) ?? null;
  return ways[chosen + step] ?? null;
}

/** Return the ancestors of a branch from the root to the branch itself. */
export function lineage(tree: BranchTree, branchId: number): BranchNode[] {
  const line: BranchNode[] = [];
  let node = tree.byId.get(branchId);
  while (node !== undefined && !line.includes(node)) {
    line.unshift(node);
    node = node.branch.parent === null ? undefined : tree.byId.get(node.branch.parent);
  }
  return line;
}
