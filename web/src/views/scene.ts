/** Contents of the overlays, computed from the page's state once per repaint. */

import type { BranchNode, BranchTree } from "../state/airways";
import { type AppState, type Cursor, crosshairLps, pathMm } from "../state/app-state";
import { kindText, lumenMm } from "../state/branch-text";
import { type PreviewRun, previewText, previewTool, runsOf } from "../state/edit-preview";
import { type ExpertPath, ghostAhead, placeOnPath } from "../state/expert";
import { forkOf } from "../state/fork-choice";
import { mm, plural } from "../state/format";
import { type LiveAnswer, leavesTreeAt, livePathLines } from "../state/live-path";
import { type SeenStation, type ShownLayer, stationsSeen, vesselsSeen } from "../state/lungs";
import { startOf } from "../state/path-search";
import { marksByPen } from "../state/pen";
import { planOf, stationsShown } from "../state/plan";
import { pointsBetween } from "../state/route";
import type { Surface } from "../state/section";
import { marksStructure, targetMarkLines } from "../state/target-mark";
import { type Armed, isBrush, takesAway, wantsPath } from "../state/tools";
import { hidesNames, shownExpert, trainingLayout } from "../state/training";
import { below, pointsFrom, type TreePlace } from "../state/tree-index";
import { asVec3, type Camera, cameraFromMatrix, type Vec3 } from "../state/vec";
import type { Grid } from "../state/volume";
import type {
  Carm,
  EditLine,
  PlannedTurn,
  PlansMessage,
  RouteInfo,
  Slab,
  UncertainPlace,
  VesselLine,
} from "../wire/messages";
import type { PlaneName } from "../wire/views";
import { type Shape, shapeOf } from "./outline";

/** A target as drawn in the views. */
export interface SceneTarget {
  lps: Vec3;
  name: string;
  reachable: boolean;
  chosen: boolean;
  hasSize: boolean;
}

/** A target with a size as drawn in the views. */
export interface SceneLesion {
  name: string;
  centre: Vec3;
  surface: Surface;
  chosen: boolean;
}

/** Contents of the overlays of all views. */
export interface Scene {
  /** Camera of the latest pose, which may be newer than the displayed pictures; null without a pose. */
  tip: Camera | null;
  /** Point where the slices intersect, LPS mm; null without one. */
  crosshair: Vec3 | null;
  followsTip: boolean;
  route: RouteInfo | null;
  /** Parts of the route that the CT shows, drawn as solid lines. The other parts are in `drawn` and dashed. */
  routeRuns: readonly (readonly Vec3[])[];
  routeLineVisible: boolean;
  /** Whether slices and the cut-plane show the lumen outline and the centrelines. */
  outlineVisible: boolean;
  /** Layers around the targets that the user has hidden. */
  hiddenLayers: readonly ShownLayer[];
  stations: readonly SeenStation[];
  /** Centrelines of the vessels; empty while they are hidden. */
  vessels: readonly VesselLine[];
  tree: BranchTree | null;
  pathMm: number | null;
  /** Turns of the planned route; empty without a plan. */
  turns: readonly PlannedTurn[];
  targets: readonly SceneTarget[];
  lesions: readonly SceneLesion[];
  /**
   * Needle path from the scope's tip at the parking position into the target, and the distance of the tip from the
   * parking position, mm; null without a needle path.
   */
  needle: { tip: Vec3; aim: Vec3; toGoMm: number | null } | null;
  root: Vec3 | null;
  /** Start point of a path search through the whole scan, while its cost function is selected; null otherwise. */
  start: Vec3 | null;
  airwayShape: Shape;
  /** Voxel grid of the volume; null without a case. */
  grid: Grid | null;
  /** Indices k of slices that were missing in the files and were interpolated. */
  interpolated: readonly number[];
  carm: Carm;
  slab: Slab;
  /** The plane of the tri-plane view under the cursor; null if there is none. */
  overPlane: PlaneName | null;
  /** Clicked points of the airway wall, LPS mm, oldest first. */
  wallPoints: readonly Vec3[];
  /** Branches that the CT does not show: bridges and branches drawn by hand. */
  drawn: readonly BranchNode[];
  /** Branches with a known lobe. */
  named: readonly BranchNode[];
  /** Branches with a name from the anatomy or the user, large branches first. */
  titled: readonly BranchNode[];
  /** End point of the tree's first branch, usually the trachea, LPS mm; null without a tree. */
  trunkEnd: Vec3 | null;
  uncertain: readonly UncertainPlace[];
  /** The branch under the cursor; null if there is none. */
  hovered: { node: BranchNode; place: TreePlace | null } | null;
  selected: BranchNode | null;
  /** ID of the branch that contains the tip; null if there is none. */
  hereId: number | null;
  /** Centreline parts that a cut at the cursor would remove, or that smoothing would change. */
  doomed: readonly (readonly Vec3[])[];
  /** End point, LPS mm, of the fork that is being moved, or that a click would select; null without one. */
  heldFork: Vec3 | null;
  /**
   * Preview of an edit, or of the question about a branch without evidence. `faint` is true while the answer is for an
   * earlier cursor position.
   */
  preview: { runs: readonly PreviewRun[]; faint: boolean } | null;
  /**
   * Path to the cursor; `leavesAt` is the index of the point at which the path leaves the tree. Null without a path.
   */
  live: { points: readonly Vec3[]; leavesAt: number } | null;
  /**
   * Tip of the tracked pen with its texts, of which the first that fits is drawn. Null unless the pen's button marks
   * its tip or the scope follows the pen.
   */
  pen: { lps: Vec3; words: readonly string[] } | null;
  /** Tip of the expert ahead of the tip, at the same place of the airways; null if no ghost is shown. */
  ghost: Vec3 | null;
  cursor: Cursor | null;
  /** Text at the cursor; `warns` draws it as a warning. Null without a text. */
  note: { lines: readonly string[]; warns: boolean } | null;
  brush: { radiusMm: number; erase: boolean } | null;
  stroke: readonly Vec3[];
}

let surfacesOf: PlansMessage | null = null;
let surfaces: ReadonlyMap<string, Omit<SceneLesion, "name" | "chosen">> = new Map();

function lesionsOf(state: AppState): SceneLesion[] {
  if (state.plans !== surfacesOf) {
    surfacesOf = state.plans;
    surfaces = new Map(
      (state.plans?.targets ?? []).map((target) => [
        target.target_id,
        {
          centre: asVec3(target.centre_lps),
          surface: { vertices: target.surface.vertices_lps.map(asVec3), triangles: target.surface.triangles },
        },
      ]),
    );
  }
  return (state.session?.targets ?? []).flatMap((target) => {
    const known = surfaces.get(target.target_id);
    return known === undefined
      ? []
      : [{ ...known, name: target.name, chosen: target.target_id === state.route?.target_id }];
  });
}

function needleOf(state: AppState): Scene["needle"] {
  const needle = state.route?.needle ?? null;
  if (needle === null || state.route === null) return null;
  const at = pathMm(state);
  return {
    tip: asVec3(needle.ends_lps[0]),
    aim: asVec3(needle.ends_lps[1]),
    toGoMm: at === null ? null : state.route.length_mm - at,
  };
}

let partsOf: BranchTree | null = null;
let parts: Pick<Scene, "drawn" | "named" | "titled" | "trunkEnd"> = {
  drawn: [],
  named: [],
  titled: [],
  trunkEnd: null,
};
let liveOf: LiveAnswer | null = null;
let live: Scene["live"] = null;
let previewOf: readonly EditLine[] = [];
let previewRuns: readonly PreviewRun[] = [];

function endOf(tree: BranchTree | null): Vec3 | null {
  const point = tree?.root.branch.points.at(-1);
  return point === undefined ? null : asVec3(point);
}

/** Return the contents of the scene that depend on the cursor, the selection and the active tool. */
function pointedAt(
  state: AppState,
): Pick<
  Scene,
  | "drawn"
  | "named"
  | "titled"
  | "trunkEnd"
  | "uncertain"
  | "hovered"
  | "selected"
  | "doomed"
  | "heldFork"
  | "preview"
  | "live"
  | "note"
  | "brush"
  | "stroke"
> {
  const { tree, ui, livePath, preview, doubt } = state;
  if (tree !== partsOf) {
    partsOf = tree;
    const nodes = tree === null ? [] : [...tree.byId.values()];
    parts = {
      drawn: nodes.filter((node) => node.branch.kind !== "tracked"),
      named: nodes.filter((node) => node.lobe !== null),
      titled: nodes.filter((node) => node.branch.name !== null).sort((a, b) => b.diameterMm - a.diameterMm),
      trunkEnd: endOf(tree),
    };
  }
  if (livePath !== liveOf) {
    liveOf = livePath;
    const points = livePath?.answer.points_lps.map((point) => asVec3(point)) ?? [];
    const leavesAt = livePath === null ? 0 : leavesTreeAt(livePath.answer.points_lps, livePath.answer.new_mm);
    live = points.length > 1 ? { points, leavesAt } : null;
  }
  const lines = doubt === null ? (preview?.answer?.lines ?? []) : [doubt.line];
  if (lines !== previewOf) {
    previewOf = lines;
    previewRuns = runsOf(lines);
  }
  const node = ui.hovered === null ? undefined : tree?.byId.get(ui.hovered.branchId);
  const hovered = node === undefined || ui.hovered === null ? null : { node, place: ui.hovered.place };
  // The end of the route does not count as a selection, because the route line already shows it.
  const selected = ui.selected === null ? null : (tree?.byId.get(ui.selected) ?? null);
  const forkAtCursor =
    tree !== null && ui.armed === "fork" && hovered !== null
      ? forkOf(tree, hovered.node.branch.id, hovered.place?.alongMm ?? 0)
      : null;
  const fork = ui.forkHeld ?? forkAtCursor;
  const held = fork === null ? undefined : tree?.byId.get(fork)?.branch.points.at(-1);
  return {
    ...parts,
    uncertain: tree?.uncertain ?? [],
    hovered,
    selected,
    doomed: hovered === null ? [] : branchesUnderTool(ui.armed, hovered.node, hovered.place?.alongMm ?? 0),
    heldFork: held === undefined ? null : asVec3(held),
    preview: previewRuns.length === 0 ? null : { runs: previewRuns, faint: doubt === null && preview?.stale === true },
    live,
    note: cursorNoteOf(state, hovered?.node ?? null),
    brush: isBrush(ui.armed) ? { radiusMm: ui.brushMm, erase: takesAway(ui.armed) } : null,
    stroke: ui.stroke,
    // A task of the training may hide the names that the trainee must recognise.
    ...(hidesNames(state) ? NO_NAMES : {}),
  };
}

function branchesUnderTool(armed: Armed | null, node: BranchNode, alongMm: number): Vec3[][] {
  if (armed === "smooth") return [pointsFrom(node, 0)];
  return armed === "cut" ? below(node).map((member) => pointsFrom(member, member === node ? alongMm : 0)) : [];
}

function cursorNoteOf(state: AppState, hovered: BranchNode | null): Scene["note"] {
  const { ui, livePath, preview, doubt } = state;
  // The question about a branch without evidence is shown beside the tool, not at the cursor.
  if (doubt !== null) return null;
  // While the path leads to the pen, its text is shown at the pen.
  if (ui.penLeads) return null;
  if (previewTool(ui.armed, ui.forkHeld !== null) !== null) return preview === null ? null : previewText(preview);
  if (marksStructure(state)) return targetMarkLines(state);
  if (wantsPath(ui.armed)) return livePath === null ? null : livePathLines(livePath.answer);
  if (hovered === null) return null;
  const name = branchLine(hovered);
  if (ui.armed === "cut") {
    const more = below(hovered).length - 1;
    return {
      lines: [`cut ${name}`, ...(more > 0 ? [`and ${plural(more, "branch", "branches")} beyond`] : [])],
      warns: true,
    };
  }
  if (ui.armed === "smooth") return { lines: [`smooth ${name}`], warns: true };
  return isBrush(ui.armed) ? null : { lines: [name], warns: hovered.branch.kind !== "tracked" };
}

function branchLine(node: BranchNode): string {
  const kind = kindText(node.branch.kind);
  const lumen = lumenMm(node);
  if (kind !== null) return `${node.label} (${kind})`;
  return lumen === null ? node.label : `${node.label}, ${mm(lumen)}`;
}

/** Return the text about a path in a long form and in shorter forms. */
function shorter({ answer }: LiveAnswer): string[] {
  const { lines } = livePathLines(answer);
  const length = answer.length_mm === null ? "no path" : mm(answer.length_mm, 0);
  return [lines.slice(0, 2).join(", "), ...lines.slice(0, 1), length];
}

function penOf(state: AppState): Scene["pen"] {
  const { pen, ui, livePath } = state;
  if (pen === null || pen.lps === null || !(marksByPen(ui.armed) || pen.off_mm !== null)) return null;
  return { lps: asVec3(pen.lps), words: ui.penLeads && livePath !== null ? shorter(livePath) : [] };
}

let cachedFor: RouteInfo | null = null;
let cachedRuns: readonly (readonly Vec3[])[] = [];

function shownRuns(route: RouteInfo | null): readonly (readonly Vec3[])[] {
  if (route === null) return [];
  if (route.spans.every((span) => span.kind === "tracked")) {
    return [route.points_lps.map((point) => asVec3(point))];
  }
  const runs: { fromMm: number; toMm: number }[] = [];
  for (const span of route.spans) {
    if (span.kind !== "tracked") continue;
    const last = runs.at(-1);
    if (last !== undefined && span.from_mm - last.toMm < 1e-3) last.toMm = span.to_mm;
    else runs.push({ fromMm: span.from_mm, toMm: span.to_mm });
  }
  return runs.map(({ fromMm, toMm }) => pointsBetween(route, fromMm, toMm));
}

/** The turns without a plan: one object, so that overlays are not repainted. */
const NO_TURNS: readonly PlannedTurn[] = [];

let last: Scene | null = null;

/**
 * Return the scene for a state. Parts with the same contents as before are the same objects, so that overlays are not
 * repainted.
 */
export function sceneOf(state: AppState): Scene {
  const made = buildScene(state);
  const before = last;
  if (before !== null) {
    for (const key of MADE) if (isSame(before[key], made[key])) Object.assign(made, { [key]: before[key] });
  }
  last = made;
  return made;
}

const MADE = [
  "tip",
  "crosshair",
  "targets",
  "lesions",
  "stations",
  "needle",
  "root",
  "start",
  "hovered",
  "doomed",
  "heldFork",
  "preview",
  "live",
  "note",
  "brush",
  "pen",
  "ghost",
  "uncertain",
  "wallPoints",
  "grid",
  "carm",
  "slab",
] as const satisfies readonly (keyof Scene)[];

/**
 * Return whether two values are equal: lists and plain objects by content to a limited depth, other values by identity.
 */
function isSame(a: unknown, b: unknown, depth = 3): boolean {
  if (Object.is(a, b)) return true;
  if (depth === 0 || typeof a !== "object" || typeof b !== "object" || a === null || b === null) return false;
  if (Array.isArray(a) !== Array.isArray(b)) return false;
  const keys = Object.keys(a);
  if (keys.length !== Object.keys(b).length || keys.length > MAX_PARTS) return false;
  return keys.every((key) => isSame(Reflect.get(a, key), Reflect.get(b, key), depth - 1));
}

/**
 * Number of elements above which lists are compared by identity, because long lists are slow to compare and rarely
 * change.
 */
const MAX_PARTS = 64;

/** Parts of the scene while names are hidden; a hovered branch would have its name, a selected one would show a place. */
const NO_NAMES = { named: [], titled: [], hovered: null, selected: null, note: null } as const satisfies Partial<Scene>;

let ghostPath: ExpertPath | null = null;
let ghostFrom = 0;

/** Return the expert's tip ahead of the tip; null if no ghost is shown, or if the expert was not at this place. */
function ghostOf(state: AppState, tip: Vec3 | null): Vec3 | null {
  const path = shownExpert(state);
  if (path !== ghostPath) {
    ghostPath = path;
    ghostFrom = 0;
  }
  if (path === null || tip === null) return null;
  const place = placeOnPath(path, tip, ghostFrom);
  if (place === null) return null;
  ghostFrom = place;
  return ghostAhead(path, place);
}

function buildScene(state: AppState): Scene {
  if (state.route !== cachedFor) {
    cachedFor = state.route;
    cachedRuns = shownRuns(state.route);
  }
  const tip = state.pose === null ? null : cameraFromMatrix(state.pose.lps_from_camera);
  const cross = crosshairLps(state);
  return {
    tip,
    crosshair: cross ?? tip?.position ?? null,
    followsTip: cross === null,
    route: state.route,
    routeRuns: cachedRuns,
    // The route would show the way that the trainee must find.
    routeLineVisible: state.ui.routeLineVisible && trainingLayout(state) === undefined,
    outlineVisible: state.ui.outlineVisible,
    hiddenLayers: state.ui.hiddenLayers,
    stations: stationsSeen(
      state.lungs,
      state.ui.hiddenLayers,
      stationsShown(planOf(state.plans, state.route?.target_id ?? null), cross),
    ),
    vessels: vesselsSeen(state.lungs, state.ui.hiddenLayers),
    tree: state.tree,
    pathMm: pathMm(state),
    turns: state.plans?.turns ?? NO_TURNS,
    targets:
      state.session?.targets.map((target) => ({
        lps: asVec3(target.used_lps ?? target.lps),
        name: target.name,
        reachable: target.problem === null,
        chosen: target.target_id === state.route?.target_id,
        hasSize: target.has_size,
      })) ?? [],
    lesions: lesionsOf(state),
    needle: needleOf(state),
    root: state.session?.root_lps == null ? null : asVec3(state.session.root_lps),
    start: state.ui.pathCost === "lumen" ? null : startOf(state.ui, state.session),
    airwayShape: shapeOf(state.look.outline),
    grid: state.session?.case ?? null,
    interpolated: state.session?.case?.interpolated_slices ?? [],
    carm: state.sight.carm,
    slab: state.sight.slab,
    overPlane: state.ui.overPlane,
    wallPoints: state.picks.map((point) => point.lps),
    hereId: state.pose?.branch_id ?? null,
    pen: penOf(state),
    ghost: ghostOf(state, tip?.position ?? null),
    cursor: state.ui.cursor,
    ...pointedAt(state),
  };
}
