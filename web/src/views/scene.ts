/** What is drawn over the pictures, taken from the state once per repaint. */

import type { BranchNode, BranchTree } from "../state/airways";
import { type AppState, type Cursor, crosshairLps, maskOf, pathMm } from "../state/app-state";
import { mm, plural } from "../state/format";
import { type LiveAnswer, leavesTreeAt, livePathLines } from "../state/live-path";
import { isBrush, wantsPath } from "../state/tools";
import { below, nearestPlace, pointsFrom, type TreePlace } from "../state/tree-index";
import type { PlaneName } from "../state/tri-plane";
import { asVec3, type Camera, cameraFromMatrix, distance, type Vec3 } from "../state/vec";
import type { Grid } from "../state/volume";
import type { RouteInfo, StateMessage, UncertainPlace } from "../wire/messages";
import { type Shape, shapeOf } from "./outline";

export interface SceneTarget {
  lps: Vec3;
  name: string;
  reachable: boolean;
  chosen: boolean;
}

export interface Scene {
  /** The newest pose, ahead of the pictures. */
  tip: Camera | null;
  /** Where the slices meet. */
  crosshair: Vec3 | null;
  followsTip: boolean;
  route: RouteInfo | null;
  routePoints: readonly Vec3[];
  routeLineVisible: boolean;
  pathMm: number | null;
  targets: readonly SceneTarget[];
  root: Vec3 | null;
  airwayShape: Shape;
  /** The volume's box. */
  grid: Grid | null;
  carm: StateMessage["carm"] | null;
  slab: StateMessage["slab"] | null;
  /** The plane of the tri-plane view under the cursor. */
  overPlane: PlaneName | null;
  /** Clicked points of the wall, newest last. */
  wallPoints: readonly Vec3[];
  bridges: readonly BranchNode[];
  /** Branches of a known lobe. */
  named: readonly BranchNode[];
  /** Branches with an anatomical name or a person's, large ones first. */
  titled: readonly BranchNode[];
  uncertain: readonly UncertainPlace[];
  /** The branch that is pointed at. */
  hovered: { node: BranchNode; place: TreePlace | null } | null;
  selected: BranchNode | null;
  /** The branch that the tip is in. */
  hereId: number | null;
  /** What a cut under the cursor would take away. */
  doomed: readonly (readonly Vec3[])[];
  /** The fork that is being moved. */
  heldFork: Vec3 | null;
  /** From the tree straight to the cursor, where there is no way yet: what a click would look for, or bridge. */
  reach: { from: Vec3; to: Vec3; bridges: boolean } | null;
  /** The way to the cursor; leaves the tree at a point of its own. */
  live: { points: readonly Vec3[]; leavesAt: number } | null;
  cursor: Cursor | null;
  /** What is said at the cursor. */
  note: { lines: readonly string[]; warns: boolean } | null;
  brush: { radiusMm: number; erase: boolean } | null;
  stroke: readonly Vec3[];
}

let partsOf: BranchTree | null = null;
let parts: Pick<Scene, "bridges" | "named" | "titled"> = { bridges: [], named: [], titled: [] };
let liveOf: LiveAnswer | null = null;
let live: Scene["live"] = null;

/** What is pointed at, and what is in the hand. */
function pointedAt(
  state: AppState,
): Pick<
  Scene,
  | "bridges"
  | "named"
  | "titled"
  | "uncertain"
  | "hovered"
  | "selected"
  | "doomed"
  | "heldFork"
  | "reach"
  | "live"
  | "note"
  | "brush"
  | "stroke"
> {
  const { tree, ui, livePath } = state;
  if (tree !== partsOf) {
    partsOf = tree;
    const nodes = tree === null ? [] : [...tree.byId.values()];
    parts = {
      bridges: nodes.filter((node) => node.branch.kind === "bridge"),
      named: nodes.filter((node) => node.lobe !== null),
      titled: nodes.filter((node) => node.branch.name !== null).sort((a, b) => b.diameterMm - a.diameterMm),
    };
  }
  if (livePath !== liveOf) {
    liveOf = livePath;
    const points = livePath?.answer.points_lps.map((point) => asVec3(point)) ?? [];
    const leavesAt = livePath === null ? 0 : leavesTreeAt(livePath.answer.points_lps, livePath.answer.new_mm);
    live = points.length > 1 ? { points, leavesAt } : null;
  }
  const node = ui.hovered === null ? undefined : tree?.byId.get(ui.hovered.branchId);
  const hovered = node === undefined || ui.hovered === null ? null : { node, place: ui.hovered.place };
  // The route's end is no choice of its own: its line is drawn already.
  const selected = ui.selected === null ? null : (tree?.byId.get(ui.selected) ?? null);
  const reach = reachOf(state);
  const held = ui.forkHeld === null ? undefined : tree?.byId.get(ui.forkHeld)?.branch.points.at(-1);
  return {
    ...parts,
    uncertain: tree?.uncertain ?? [],
    hovered,
    selected,
    doomed: ui.armed === "cut" && hovered !== null ? doomedBy(hovered.node, hovered.place?.alongMm ?? 0) : [],
    heldFork: held === undefined ? null : asVec3(held),
    reach,
    live,
    note: noteOf(state, hovered?.node ?? null, reach),
    brush: isBrush(ui.armed) ? { radiusMm: ui.brushMm, erase: ui.armed === "erase" } : null,
    stroke: ui.stroke,
  };
}

function doomedBy(node: BranchNode, alongMm: number): Vec3[][] {
  return below(node).map((member) => pointsFrom(member, member === node ? alongMm : 0));
}

/** Nearer than this the cursor is on the tree. */
const ON_TREE_MM = 0.5;

function reachOf(state: AppState): Scene["reach"] {
  const { ui, tree, livePath } = state;
  const bridges = ui.armed === "bridge";
  const searches = ui.armed === "add" && livePath !== null && livePath.answer.problem !== null;
  if (tree === null || ui.pointedLps === null || !(bridges || searches)) return null;
  const nearest = nearestPlace(tree.index, ui.pointedLps);
  if (nearest === null || nearest.distanceMm < ON_TREE_MM) return null;
  return { from: nearest.lps, to: ui.pointedLps, bridges };
}

function noteOf(state: AppState, hovered: BranchNode | null, reach: Scene["reach"]): Scene["note"] {
  const { ui, livePath } = state;
  if (reach !== null) {
    const far = `${mm(distance(reach.from, reach.to))} from the tree`;
    if (reach.bridges) return { lines: ["bridge to here", far], warns: true };
    const why = livePath === null ? [] : livePathLines(livePath.answer).lines;
    return { lines: [...why, `${far}: a click looks for an airway up to here`], warns: false };
  }
  if (wantsPath(ui.armed, ui.forkHeld !== null)) return livePath === null ? null : livePathLines(livePath.answer);
  if (hovered === null) return null;
  const name = branchLine(hovered);
  if (ui.armed === "cut") {
    const more = below(hovered).length - 1;
    return {
      lines: [`cut ${name}`, ...(more > 0 ? [`and ${plural(more, "branch", "branches")} beyond`] : [])],
      warns: true,
    };
  }
  return isBrush(ui.armed) ? null : { lines: [name], warns: hovered.branch.kind === "bridge" };
}

const branchLine = (node: BranchNode): string =>
  node.branch.kind === "bridge" ? `${node.label} (bridge)` : `${node.label}, ${mm(node.diameterMm)}`;

let cachedFor: RouteInfo | null = null;
let cachedPoints: readonly Vec3[] = [];

export function sceneOf(state: AppState): Scene {
  if (state.route !== cachedFor) {
    cachedFor = state.route;
    cachedPoints = state.route?.points_lps.map((point) => asVec3(point)) ?? [];
  }
  const tip = state.pose === null ? null : cameraFromMatrix(state.pose.lps_from_camera);
  const cross = crosshairLps(state);
  return {
    tip,
    crosshair: cross ?? tip?.position ?? null,
    followsTip: cross === null,
    route: state.route,
    routePoints: cachedPoints,
    routeLineVisible: state.ui.routeLineVisible,
    pathMm: pathMm(state),
    targets:
      state.session?.targets.map((target) => ({
        lps: asVec3(target.used_lps ?? target.lps),
        name: target.name,
        reachable: target.problem === null,
        chosen: target.target_id === state.route?.target_id,
      })) ?? [],
    root: state.session?.root_lps == null ? null : asVec3(state.session.root_lps),
    airwayShape: shapeOf(maskOf(state)),
    grid: state.session?.case ?? null,
    carm: state.session?.carm ?? null,
    slab: state.session?.slab ?? null,
    overPlane: state.ui.overPlane,
    wallPoints: state.picks.map((point) => point.lps),
    hereId: state.pose?.branch_id ?? null,
    cursor: state.ui.cursor,
    ...pointedAt(state),
  };
}
