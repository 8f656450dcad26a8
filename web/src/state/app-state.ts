/** State of the workstation page, and the reducer that changes it. */

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

/** The branch under the cursor in a view or list, with the place on the branch if it is known. */
export interface Hovered {
  readonly branchId: number;
  readonly place: TreePlace | null;
}

/** Position of the cursor: the view that contains it, and its coordinates in the view in CSS px. */
export interface Cursor {
  readonly view: ViewName;
  readonly x: number;
  readonly y: number;
}

/** Status of the connection to the server. */
export interface Connection {
  readonly status: "connecting" | "open" | "lost" | "refused";
  /** The server's reason, as text for the user; null if it gave none. */
  readonly reason: string | null;
  /** Time of the next connection attempt on the page's clock, ms; null if an attempt is running or none is planned. */
  readonly retryAtMs: number | null;
}

/** An error or notice for the user. */
export interface Message {
  readonly id: number;
  readonly kind: "error" | "notice";
  readonly code: string;
  readonly message: string;
  readonly action: string | null;
}

/** Progress of an upload. */
export interface Upload {
  readonly sentBytes: number;
  readonly totalBytes: number;
  readonly numFiles: number;
}

/** State of the user interface that the server does not know. */
export interface Ui {
  readonly step: Step;
  readonly full: CellName | null;
  /** The view that each place of the window shows. */
  readonly shown: ShownViews;
  /** The plane of the tri-plane view that a drag would move. */
  readonly overPlane: PlaneName | null;
  readonly armed: Armed | null;
  /** Cost function of the path search to the next target, and the start of the path if the user has marked one. */
  readonly pathCost: PathCost;
  readonly pathStart: Vec3 | null;
  /** The branch whose end the user is moving. */
  readonly forkHeld: number | null;
  readonly brushMm: number;
  /** The target whose boundary the brush changes. */
  readonly brushedTarget: string | null;
  readonly brushIsBall: boolean;
  /** Points of the current brush stroke, LPS mm. */
  readonly stroke: readonly Vec3[];
  readonly hovered: Hovered | null;
  /** The branch whose measurements are shown; null selects the branch of the route. */
  readonly selected: number | null;
  /** The branch that the user is renaming. */
  readonly renaming: number | null;
  readonly cursor: Cursor | null;
  /** The patient point under the cursor (LPS mm), if the view provides one. */
  readonly pointedLps: Vec3 | null;
  readonly keyCardOpen: boolean;
  /** Whether the dialog that saves the case under a name is open. */
  readonly saveOpen: boolean;
  /** Whether the dialog with all cases and their disk usage is open. */
  readonly storageOpen: boolean;
  /** Time of the previous use of the continued case whose notice the user has closed; null if none was closed. */
  readonly continuedReadS: number | null;
  /** The list at the top of the left column. */
  readonly list: "airways" | "history";
  /** Whether the panel of input devices replaces the panel of the step. */
  readonly devicesOpen: boolean;
  /** Whether the panel of key frames replaces the panel of the step. */
  readonly keysOpen: boolean;
  /** Speed of the automatic flight, mm/s. */
  readonly autoSpeedMmS: number;
  /** Suffix of the airway file that is being generated; null if none is. */
  readonly making: string | null;
  /** Whether the airway view has locked the mouse pointer. */
  readonly mouseLocked: boolean;
  /** Availability of a VR headset in this browser; null until the browser has reported it. */
  readonly headset: "no-webxr" | "no-headset" | "ready" | "inside" | null;
  readonly routeLineVisible: boolean;
  /** Whether slices and the cut-plane show the lumen outline and the centrelines. */
  readonly outlineVisible: boolean;
  /** Layers around the targets that the user has hidden. */
  readonly hiddenLayers: readonly ShownLayer[];
  readonly advancing: boolean;
  readonly cursorLps: Vec3 | null;
  /** Whether the live path leads to the pen, which has moved later than the cursor. */
  readonly penLeads: boolean;
}

/** The complete state of the page. */
export interface AppState {
  readonly connection: Connection;
  readonly version: string | null;
  /** Whether this window only watches another user's workstation. */
  readonly watches: boolean;
  /** Permission to watch this workstation, and its watchers; null in a window that itself watches. */
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
  /** The computers that render together with this one; null if there are none. */
  readonly cluster: ClusterMessage | null;
  /** Points of the airway wall that the user has clicked in the airway view, oldest first. */
  readonly picks: readonly WallPoint[];
  /**
   * Header of the picture that each place shows; the header of the replacement if another picture replaces a view's
   * picture.
   */
  readonly frames: Readonly<Partial<Record<ViewName, PictureHeader>>>;
  readonly pace: Pace;
  /** Value of the voxel under the cursor from the latest answer; null while the cursor is not over a slice. */
  readonly probed: ValueMessage | null;
  /** The path to the cursor. */
  readonly livePath: LiveAnswer | null;
  /** Result of a click at the cursor, while a tool with a preview is active. */
  readonly preview: Preview | null;
  /** A branch that was not added for lack of evidence; the page asks the user whether to draw it by hand. */
  readonly doubt: NoEvidenceMessage | null;
  /** Measurements along a branch from the latest answer. */
  readonly detail: BranchDetailMessage | null;
  readonly upload: Upload | null;
  /** Input devices from the latest message of the server. */
  readonly devices: DevicesMessage | null;
  /** The tracked pen that moves the tip; null if no pen does. */
  readonly pen: PenMessage | null;
  /** The key frames and the flight through them. */
  readonly keyFrames: KeyFramesMessage | null;
  /** Targets with a size, their routes, and the instruments that can reach them. */
  readonly plans: PlansMessage | null;
  /** Structures of the lungs that were mapped around the targets. */
  readonly lungs: LungsMessage | null;
  /** Flights that were recorded in the case. */
  readonly flights: readonly FlightInfo[];
  /** Commands executed on the case, and how many of them are not undone. */
  readonly history: HistoryMessage | null;
  /** Playback of the flight through the key frames. */
  readonly playing: Playing;
  /** Number of the recorded flight that is or was last replayed; null if none was. */
  readonly flownFlight: number | null;
  /** Playback of the recorded flight. */
  readonly replaying: Playing;
  /** Speed of the tip, mm/s; null at rest. */
  readonly speedMmS: number | null;
  readonly ui: Ui;
  /** The latest value from the server, combined with the changes that this page has sent since. */
  readonly look: Look;
  readonly sight: Sight;
  readonly local: {
    readonly look: Local<Look>;
    readonly sight: Local<Sight>;
    readonly pathMm: Optimistic<number> | null;
  };
}

const NOTHING_LOCAL: AppState["local"] = { look: {}, sight: {}, pathMm: null };

/** State of the page before the first message of the server. */
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

/** An event that changes the state. */
export type AppEvent =
  | { kind: "server"; message: ServerMessage }
  /** A command that was sent, with its number on this connection. */
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

/** Answers that are valid for one case and one connection only. */
const NOTHING_SHOWN = { livePath: null, preview: null, doubt: null, detail: null } as const;

/** Interface state without an active tool and without anything under the cursor. */
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

/** Path search of a new case: through the lumen, without a marked start. */
const FIRST_SEARCH = { pathCost: "lumen", pathStart: null } as const;

/** Return the state after an event. */
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
        // A change of the step also closes the panel of key frames, so that the step's panel is visible.
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
      // An answer that arrives after the cursor has left is discarded.
      return state.ui.cursorLps === null ? state : { ...state, probed: message };
    case "picked":
    case "live_path":
    case "edit_preview":
      // The workstation first decides whether the answer is still wanted.
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

/**
 * Return the state after the server has executed the first `number` commands of this connection and sent their results.
 */
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

/** Return the state with a new tree; references to branches that no longer exist are cleared. */
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

/** Return the branch whose measurements are shown. */
export function shownBranch(state: AppState): number | null {
  return state.ui.selected ?? state.route?.spans.at(-1)?.branch_id ?? null;
}

function poseChanged(state: AppState, pose: PoseMessage): AppState {
  return state.pose !== null && pose.pose_id < state.pose.pose_id ? state : { ...state, pose };
}

/** Return the state with the expected result of a command, before the server has answered. */
function foresee(state: AppState, message: ClientMessage, number: number): AppState {
  switch (message.type) {
    case "undo":
    case "redo":
      // The command restores another look than the one that was sent.
      return { ...state, doubt: null, local: { ...state.local, look: {} } };
    case "set_scope":
      // The command sets its own field of view and outline.
      return { ...state, local: { ...state.local, look: {} } };
    case "edit_tree":
    case "set_root":
      // The question concerned another tree, or this command answers it.
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

/** Apply look and sight settings when they are sent; they stay until the server has sent the result. */
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
  // Jobs of a lost connection receive no more updates; the new connection reports its own jobs.
  const jobs = connection.status === "open" || connection.status === "connecting" ? state.jobs : [];
  // A restarted server numbers poses from the start, so the first pose of a connection always counts as the latest.
  const pose = connection.status === "open" ? null : state.pose;
  return { ...state, connection, jobs, pose, pen: null, local: NOTHING_LOCAL, ui: { ...state.ui, advancing: false } };
}

/** Largest number of notices: older notices are removed, errors stay until the user closes them. */
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

/** Return the position of the tip (LPS mm) from the latest pose. */
export function tipLps(state: AppState): Vec3 | null {
  const m = state.pose?.lps_from_camera;
  return m === undefined ? null : [m[3] ?? 0, m[7] ?? 0, m[11] ?? 0];
}

/**
 * Return the point (LPS mm) that the button of the active pen marks: the pen's tip, or the scope's tip if the pen's is
 * unknown.
 */
export function penPoint(state: AppState): Vec3 | null {
  if (state.pen === null) return null;
  return state.pen.lps === null ? tipLps(state) : asVec3(state.pen.lps);
}

/**
 * Return the point (LPS mm) where the slices intersect, including a drag that is in progress; null if it follows the
 * tip.
 */
export function crosshairLps(state: AppState): Vec3 | null {
  return asPoint(state.sight.crosshair_lps);
}

/** Return the instrument whose optics the airway view uses, or null. */
export function scopeOf(state: AppState): Scope | null {
  return state.start?.scopes.find((scope) => scope.name === state.look.scope) ?? null;
}

const LUNG_WINDOW: GreyWindow = { width_hu: 1500, level_hu: -600 };

/** Return the window width and level of the slices, in HU. */
export function greyWindow(state: AppState): GreyWindow {
  return state.sight.window ?? LUNG_WINDOW;
}

/** Return the position along the route, mm, including a drag that is in progress. */
export function pathMm(state: AppState): number | null {
  return state.local.pathMm?.value ?? state.pose?.path_mm ?? null;
}
