/** All that the screen shows, and the one function that changes it. */

import {
  type BranchDetailMessage,
  type ClientMessage,
  type ClusterMessage,
  type DevicesMessage,
  FIRST_LOOK,
  FIRST_SIGHT,
  type FlightInfo,
  type GreyWindow,
  type HistoryMessage,
  type KeyFramesMessage,
  type Look,
  type LungsMessage,
  type NoEvidenceMessage,
  type PenMessage,
  type PickedMessage,
  type PictureHeader,
  type PlansMessage,
  type PoseMessage,
  type ProgressMessage,
  type RouteInfo,
  type Scope,
  SETS,
  type ServerMessage,
  type Sight,
  type StartMessage,
  type StateMessage,
  type StatusMessage,
  type ValueMessage,
  type ViewName,
  type WatchingMessage,
} from "../wire/messages";
import type { CellName, PlaneName } from "../wire/views";
import { type BranchTree, buildTree } from "./airways";
import { caseKey } from "./case-key";
import type { Preview } from "./edit-preview";
import type { LiveAnswer } from "./live-path";
import type { ShownLayer } from "./lungs";
import { allUnderWay, type Local, type Optimistic, shown, underWay } from "./optimistic";
import { NO_PACE, type Pace } from "./pace";
import type { PathCost } from "./path-search";
import { NOT_PLAYING, type Playing } from "./playing";
import { AUTO_SPEED_MM_S } from "./speed";
import type { Step } from "./steps";
import { type Armed, FIRST_BRUSH_MM } from "./tools";
import type { TreePlace } from "./tree-index";
import { asVec3, type Vec3 } from "./vec";
import { FIRST_SHOWN, type ShownViews } from "./view-table";
import { addPick, type WallPoint } from "./wall-point";

/** A branch that the cursor is over, in whatever picture or list; the place on it where that is known. */
export interface Hovered {
  readonly branchId: number;
  readonly place: TreePlace | null;
}

/** Where the cursor is on the screen: in which view, and in CSS px of it. */
export interface Cursor {
  readonly view: ViewName;
  readonly x: number;
  readonly y: number;
}

export interface Connection {
  readonly status: "connecting" | "open" | "lost" | "refused";
  /** Words where the server said why. */
  readonly reason: string | null;
  /** When the next try starts, on the page's clock; null while one runs or none will. */
  readonly retryAtMs: number | null;
}

export interface Message {
  readonly id: number;
  readonly kind: "error" | "notice";
  readonly code: string;
  readonly message: string;
  readonly action: string | null;
}

export interface Upload {
  readonly sentBytes: number;
  readonly totalBytes: number;
  readonly numFiles: number;
}

export interface Ui {
  readonly step: Step;
  readonly full: CellName | null;
  /** Of the views that a place can show, the one that it shows. */
  readonly shown: ShownViews;
  /** The plane of the tri-plane view that a drag would move. */
  readonly overPlane: PlaneName | null;
  readonly armed: Armed | null;
  /** How the path to the next target is searched, and where it begins if that was marked. */
  readonly pathCost: PathCost;
  readonly pathStart: Vec3 | null;
  /** The branch whose end is being moved. */
  readonly forkHeld: number | null;
  readonly brushMm: number;
  /** The target whose boundary the brush changes. */
  readonly brushedTarget: string | null;
  readonly brushIsBall: boolean;
  /** What the brush has drawn since it was put down. */
  readonly stroke: readonly Vec3[];
  readonly hovered: Hovered | null;
  /** The branch whose measurements are shown; null follows the route. */
  readonly selected: number | null;
  /** The branch whose name is being typed. */
  readonly renaming: number | null;
  readonly cursor: Cursor | null;
  /** The point of the patient under it, where the picture tells. */
  readonly pointedLps: Vec3 | null;
  readonly keyCardOpen: boolean;
  /** The dialogue that gives the case a name and a place. */
  readonly saveOpen: boolean;
  /** The list of all cases, with what they take on the disk. */
  readonly storageOpen: boolean;
  /** The continued case of which that was read: when it had been used before. */
  readonly continuedReadS: number | null;
  /** Which list stands at the top of the left column. */
  readonly list: "airways" | "history";
  /** The panel of input devices stands in the place of the step's. */
  readonly devicesOpen: boolean;
  /** So does the panel of key frames. */
  readonly keysOpen: boolean;
  /** Of the flight by itself, mm/s. */
  readonly autoSpeedMmS: number;
  /** The file of the airways that is being made, by its suffix. */
  readonly making: string | null;
  /** The mouse is locked to the airway picture. */
  readonly mouseLocked: boolean;
  /** Whether there is a headset, as far as this browser tells; null until it has told. */
  readonly headset: "no-webxr" | "no-headset" | "ready" | "inside" | null;
  readonly routeLineVisible: boolean;
  /** Outline of the lumen and centrelines in slices and the cut-plane. */
  readonly outlineVisible: boolean;
  /** Of what was mapped round the targets, what is switched off. */
  readonly hiddenLayers: readonly ShownLayer[];
  readonly advancing: boolean;
  readonly cursorLps: Vec3 | null;
  /** The way that is shown is the pen's, since it has moved later than the cursor. */
  readonly penLeads: boolean;
}

export interface AppState {
  readonly connection: Connection;
  readonly version: string | null;
  /** This window only watches: somebody else's workstation, perhaps on another machine. */
  readonly watches: boolean;
  /** Who may watch this workstation, and who does; null in a window that watches itself. */
  readonly watching: WatchingMessage | null;
  readonly start: StartMessage | null;
  readonly session: StateMessage | null;
  readonly tree: BranchTree | null;
  readonly route: RouteInfo | null;
  readonly pose: PoseMessage | null;
  readonly jobs: readonly ProgressMessage[];
  readonly messages: readonly Message[];
  readonly nextMessageId: number;
  readonly status: StatusMessage | null;
  /** Rendering machines with this one; null where there are none. */
  readonly cluster: ClusterMessage | null;
  /** Points of the wall that were clicked in the airway view, newest last. */
  readonly picks: readonly WallPoint[];
  /** Header of the picture that each place shows now; where another stands in for a view, that one's. */
  readonly frames: Readonly<Partial<Record<ViewName, PictureHeader>>>;
  readonly pace: Pace;
  /** The voxel under the cursor, as last answered; null while the cursor is over no slice. */
  readonly probed: ValueMessage | null;
  /** The way to the cursor. */
  readonly livePath: LiveAnswer | null;
  /** What a click would make, while a tool that shows it is in the hand. */
  readonly preview: Preview | null;
  /** A branch that was not added for want of evidence: whether to draw it by hand is asked. */
  readonly doubt: NoEvidenceMessage | null;
  /** What was measured along a branch, as last answered. */
  readonly detail: BranchDetailMessage | null;
  readonly upload: Upload | null;
  /** Input devices, as last told. */
  readonly devices: DevicesMessage | null;
  /** The tracked pen that moves the tip; null where none does. */
  readonly pen: PenMessage | null;
  /** The key frames, and the flight through them. */
  readonly keyFrames: KeyFramesMessage | null;
  /** Targets with a size, the routes to them, and what instruments can do there. */
  readonly plans: PlansMessage | null;
  /** What was mapped round the targets. */
  readonly lungs: LungsMessage | null;
  /** What was recorded into the case. */
  readonly flights: readonly FlightInfo[];
  /** What was done, and how much of it holds. */
  readonly history: HistoryMessage | null;
  /** The flight through them, as it is played here. */
  readonly playing: Playing;
  /** The recorded flight that is flown again here, or was last; null: none was. */
  readonly flownFlight: number | null;
  /** The same, as it is played. */
  readonly replaying: Playing;
  /** How fast the tip moves, mm/s; null at rest. */
  readonly speedMmS: number | null;
  readonly ui: Ui;
  /** As the server last told them, with what was sent since. */
  readonly look: Look;
  readonly sight: Sight;
  readonly local: {
    readonly look: Local<Look>;
    readonly sight: Local<Sight>;
    readonly pathMm: Optimistic<number> | null;
  };
}

const NOTHING_LOCAL: AppState["local"] = { look: {}, sight: {}, pathMm: null };

export const INITIAL_STATE: AppState = {
  connection: { status: "connecting", reason: null, retryAtMs: null },
  version: null,
  watches: false,
  watching: null,
  start: null,
  session: null,
  tree: null,
  route: null,
  pose: null,
  jobs: [],
  messages: [],
  nextMessageId: 1,
  status: null,
  cluster: null,
  picks: [],
  frames: {},
  pace: NO_PACE,
  probed: null,
  livePath: null,
  preview: null,
  doubt: null,
  detail: null,
  upload: null,
  devices: null,
  pen: null,
  keyFrames: null,
  plans: null,
  lungs: null,
  flights: [],
  history: null,
  playing: NOT_PLAYING,
  flownFlight: null,
  replaying: NOT_PLAYING,
  speedMmS: null,
  ui: {
    step: "open",
    full: null,
    shown: FIRST_SHOWN,
    overPlane: null,
    armed: null,
    pathCost: "lumen",
    pathStart: null,
    forkHeld: null,
    brushMm: FIRST_BRUSH_MM,
    brushedTarget: null,
    brushIsBall: false,
    stroke: [],
    hovered: null,
    selected: null,
    renaming: null,
    cursor: null,
    pointedLps: null,
    keyCardOpen: false,
    saveOpen: false,
    storageOpen: false,
    continuedReadS: null,
    list: "airways",
    devicesOpen: false,
    keysOpen: false,
    autoSpeedMmS: AUTO_SPEED_MM_S,
    making: null,
    mouseLocked: false,
    headset: null,
    routeLineVisible: true,
    outlineVisible: true,
    hiddenLayers: [],
    advancing: false,
    cursorLps: null,
    penLeads: false,
  },
  look: FIRST_LOOK,
  sight: FIRST_SIGHT,
  local: NOTHING_LOCAL,
};

export type AppEvent =
  | { kind: "server"; message: ServerMessage }
  /** A command, with its number among those of this connection. */
  | { kind: "sent"; message: ClientMessage; number: number }
  | { kind: "connection"; connection: Connection }
  | { kind: "picture"; header: PictureHeader }
  | { kind: "picked"; message: PickedMessage }
  | { kind: "picks"; picks: readonly WallPoint[] }
  | { kind: "live_path"; livePath: LiveAnswer | null }
  | { kind: "preview"; preview: Preview | null }
  | { kind: "doubt_answered" }
  | { kind: "pace"; pace: Pace }
  | { kind: "speed"; speedMmS: number | null }
  | { kind: "playing"; playing: Playing }
  | { kind: "replaying"; flownFlight: number | null; replaying: Playing }
  | { kind: "upload"; upload: Upload | null }
  | { kind: "say"; message: Omit<Message, "id"> }
  | { kind: "dismiss"; id: number }
  | { kind: "ui"; change: Partial<Ui> };

/** Of one case or one connection. */
const NOTHING_SHOWN = { livePath: null, preview: null, doubt: null, detail: null } as const;

/** Nothing in the hand, nothing under the cursor. */
const NOTHING_HELD = {
  armed: null,
  forkHeld: null,
  stroke: [],
  hovered: null,
  selected: null,
  renaming: null,
  cursor: null,
  pointedLps: null,
  cursorLps: null,
  penLeads: false,
} as const;

/** Of another case: paths through the lumen, as ever. */
const FIRST_SEARCH = { pathCost: "lumen", pathStart: null } as const;

export function reduce(state: AppState, event: AppEvent): AppState {
  switch (event.kind) {
    case "server":
      return receive(state, event.message);
    case "sent":
      return foresee(state, event.message, event.number);
    case "connection":
      return connectionChanged(state, event.connection);
    case "picture":
      return { ...state, frames: { ...state.frames, [event.header.stands_for ?? event.header.view]: event.header } };
    case "picked":
      return { ...state, picks: addPick(state.picks, event.message) };
    case "picks":
      return { ...state, picks: event.picks };
    case "live_path":
      return state.livePath === event.livePath ? state : { ...state, livePath: event.livePath };
    case "preview":
      return { ...state, preview: event.preview };
    case "doubt_answered":
      return { ...state, doubt: null };
    case "pace":
      return samePace(event.pace, state.pace) ? state : { ...state, pace: event.pace };
    case "speed":
      return state.speedMmS === event.speedMmS ? state : { ...state, speedMmS: event.speedMmS };
    case "playing":
      return { ...state, playing: event.playing };
    case "replaying":
      return { ...state, flownFlight: event.flownFlight, replaying: event.replaying };
    case "upload":
      return { ...state, upload: event.upload };
    case "say":
      return say(state, event.message);
    case "dismiss":
      return { ...state, messages: state.messages.filter((message) => message.id !== event.id) };
    case "ui":
      return {
        ...state,
        probed: event.change.cursorLps === null ? null : state.probed,
        // Whoever goes to a step wants to see its panel.
        ui: { ...state.ui, keysOpen: event.change.step === undefined && state.ui.keysOpen, ...event.change },
      };
  }
}

function receive(state: AppState, message: ServerMessage): AppState {
  switch (message.type) {
    case "hello":
      return { ...state, version: message.carina_version, watches: message.watches };
    case "start":
      return { ...state, start: message };
    case "state":
      return sessionChanged(state, message);
    case "tree":
      return treeChanged(state, message.tree === null ? null : buildTree(message.tree, message));
    case "route":
      return { ...state, route: message.route, local: { ...state.local, pathMm: null } };
    case "pose":
      return poseChanged(state, message);
    case "handled":
      return handled(state, message.number);
    case "value":
      // An answer that comes after the cursor has left says nothing any more.
      return state.ui.cursorLps === null ? state : { ...state, probed: message };
    case "picked":
    case "live_path":
    case "edit_preview":
      // The workstation judges first whether the answer is still wanted.
      return state;
    case "branch_detail":
      return { ...state, detail: message };
    case "progress":
      return {
        ...state,
        jobs: state.jobs.some((job) => job.job_id === message.job_id)
          ? state.jobs.map((job) => (job.job_id === message.job_id ? message : job))
          : [...state.jobs, message],
      };
    case "done":
      return { ...state, jobs: state.jobs.filter((job) => job.job_id !== message.job_id) };
    case "no_evidence":
      return { ...state, doubt: message, preview: null };
    case "error":
      return say(state, { kind: "error", code: message.code, message: message.message, action: message.action });
    case "notice":
      return say(state, { kind: "notice", code: "notice", message: message.message, action: null });
    case "status":
      return { ...state, status: message };
    case "devices":
      return { ...state, devices: message };
    case "start_marked": {
      const armed = state.ui.armed === "start" ? null : state.ui.armed;
      return { ...state, ui: { ...state.ui, armed, pathStart: asVec3(message.lps) } };
    }
    case "pen":
      return { ...state, pen: message.device === null ? null : message };
    case "plans":
      return { ...state, plans: message };
    case "lungs":
      return { ...state, lungs: message };
    case "key_frames":
      return { ...state, keyFrames: message };
    case "flights":
      return { ...state, flights: message.flights };
    case "history":
      return { ...state, history: message };
    case "watching":
      return { ...state, watching: message };
    case "cluster":
      return { ...state, cluster: message };
  }
}

function sessionChanged(state: AppState, session: StateMessage): AppState {
  const before = state.session?.case ?? null;
  const now = session.case;
  let next: AppState = { ...state, session };
  if (now === null && before !== null) {
    next = {
      ...next,
      ...NOTHING_SHOWN,
      devices: null,
      pen: null,
      keyFrames: null,
      plans: null,
      lungs: null,
      flights: [],
      history: null,
    };
    next = { ...next, speedMmS: null };
    next = { ...next, frames: {}, picks: [], pose: null, route: null, tree: null, status: null, local: NOTHING_LOCAL };
    next = {
      ...next,
      ui: {
        ...next.ui,
        ...NOTHING_HELD,
        ...FIRST_SEARCH,
        full: null,
        advancing: false,
        keysOpen: false,
        saveOpen: false,
        step: "open",
      },
    };
  } else if (now !== null && caseKey(state.session) !== caseKey(session)) {
    const hasFindings = now.quality.length + now.warnings.length > 0 || !now.is_hu;
    const ui: Ui = { ...next.ui, ...NOTHING_HELD, ...FIRST_SEARCH, step: hasFindings ? "check" : "airways" };
    next = { ...next, ...NOTHING_SHOWN, frames: {}, picks: [], local: NOTHING_LOCAL, ui };
  }
  return { ...next, look: shown(next.local.look, session.look), sight: shown(next.local.sight, session.sight) };
}

/** So many commands of this connection are done, and the server has told what came of them. */
function handled(state: AppState, number: number): AppState {
  const { session, local } = state;
  const now = {
    look: allUnderWay(local.look, number),
    sight: allUnderWay(local.sight, number),
    pathMm: underWay(local.pathMm, number),
  };
  const isAsBefore =
    now.pathMm === local.pathMm &&
    numberOf(now.look) === numberOf(local.look) &&
    numberOf(now.sight) === numberOf(local.sight);
  if (isAsBefore || session === null) return state;
  return { ...state, local: now, look: shown(now.look, session.look), sight: shown(now.sight, session.sight) };
}

const numberOf = (values: object): number => Object.keys(values).length;

/** Branches that are gone are not pointed at any more. */
function treeChanged(state: AppState, tree: BranchTree | null): AppState {
  const kept = (id: number | null): number | null => (id !== null && tree?.byId.has(id) === true ? id : null);
  const { ui } = state;
  return {
    ...state,
    tree,
    detail: null,
    ui: {
      ...ui,
      hovered: null,
      selected: kept(ui.selected),
      forkHeld: kept(ui.forkHeld),
      renaming: kept(ui.renaming),
    },
  };
}

/** The branch whose measurements are shown. */
export function shownBranch(state: AppState): number | null {
  return state.ui.selected ?? state.route?.spans.at(-1)?.branch_id ?? null;
}

function poseChanged(state: AppState, pose: PoseMessage): AppState {
  return state.pose !== null && pose.pose_id < state.pose.pose_id ? state : { ...state, pose };
}

/** What the person should see at once, before the server has answered. */
function foresee(state: AppState, message: ClientMessage, number: number): AppState {
  switch (message.type) {
    case "undo":
    case "redo":
      // Another look comes back than the one that was sent.
      return { ...state, doubt: null, local: { ...state.local, look: {} } };
    case "set_scope":
      // It brings its own field of view and outline.
      return { ...state, local: { ...state.local, look: {} } };
    case "edit_tree":
    case "set_root":
      // Of another tree than the one that was asked about, or the answer itself.
      return { ...state, doubt: null };
    case "go_to":
      return { ...state, local: { ...state.local, pathMm: { value: message.path_mm, number } } };
    case "steer":
    case "next_fork":
    case "previous_fork":
    case "place":
      return state.local.pathMm === null ? state : { ...state, local: { ...state.local, pathMm: null } };
    case "accept_notice":
      return state.start === null ? state : { ...state, start: { ...state.start, notice_accepted: true } };
    default:
      return message.type in SETS ? fieldSet(state, message as FieldSetting, number) : state;
  }
}

type FieldSetting = Extract<ClientMessage, { type: keyof typeof SETS }>;

/** Look and sight hold as soon as they are sent, until the server has told what came of it. */
function fieldSet(state: AppState, message: FieldSetting, number: number): AppState {
  const { of, field, from, by_view } = SETS[message.type];
  const { type: _, view, ...fields } = message as { type: string; view?: string } & Record<string, unknown>;
  const said = from === null ? fields : fields[from];
  const before = state[of] as unknown as Record<string, object>;
  const value = by_view && view !== undefined ? { ...before[field], [view]: said } : said;
  return {
    ...state,
    [of]: { ...before, [field]: value },
    local: { ...state.local, [of]: { ...state.local[of], [field]: { value, number } } },
  };
}

function connectionChanged(state: AppState, connection: Connection): AppState {
  // Jobs of a lost server have no news any more; the new connection tells its own.
  const jobs = connection.status === "open" || connection.status === "connecting" ? state.jobs : [];
  // A server counts poses anew when it is started again: the first pose of a connection is always the newest.
  const pose = connection.status === "open" ? null : state.pose;
  return { ...state, connection, jobs, pose, pen: null, local: NOTHING_LOCAL, ui: { ...state.ui, advancing: false } };
}

/** Older news leave when too many wait; errors stay until they are read. */
const MAX_NOTICES = 3;

function say(state: AppState, message: Omit<Message, "id">): AppState {
  const rest = state.messages.filter((old) => old.code !== message.code || old.message !== message.message);
  const added = [{ ...message, id: state.nextMessageId }, ...rest];
  const notices = added.filter((entry) => entry.kind === "notice").slice(0, MAX_NOTICES);
  return {
    ...state,
    nextMessageId: state.nextMessageId + 1,
    messages: added.filter((entry) => entry.kind === "error" || notices.includes(entry)),
  };
}

const asPoint = (point: readonly number[] | null): Vec3 | null => (point === null ? null : asVec3(point));

const samePace = (a: Pace, b: Pace): boolean => a.fps === b.fps && a.ageMs === b.ageMs && a.waitingMs === b.waitingMs;

/** The tip, from the newest pose. */
export function tipLps(state: AppState): Vec3 | null {
  const m = state.pose?.lps_from_camera;
  return m === undefined ? null : [m[3] ?? 0, m[7] ?? 0, m[11] ?? 0];
}

/** The point that an armed pen's button marks: the pen's own tip, or the scope's where nobody knows where that is. */
export function penPoint(state: AppState): Vec3 | null {
  if (state.pen === null) return null;
  return state.pen.lps === null ? tipLps(state) : asVec3(state.pen.lps);
}

/** The point that the slices meet at, moved at once while a person drags it; null follows the tip. */
export function crosshairLps(state: AppState): Vec3 | null {
  return asPoint(state.sight.crosshair_lps);
}

/** The instrument that the airway view is seen through, or null. */
export function scopeOf(state: AppState): Scope | null {
  return state.start?.scopes.find((scope) => scope.name === state.look.scope) ?? null;
}

const LUNG_WINDOW: GreyWindow = { width_hu: 1500, level_hu: -600 };

export function greyWindow(state: AppState): GreyWindow {
  return state.sight.window ?? LUNG_WINDOW;
}

export function pathMm(state: AppState): number | null {
  return state.local.pathMm?.value ?? state.pose?.path_mm ?? null;
}
