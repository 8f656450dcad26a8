/** State of the workstation page, and the reducer that computes the state after an event. */

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
  type ProcessorChoiceMessage,
  type ProgressMessage,
  type RouteInfo,
  type Scope,
  SETS,
  type ServerMessage,
  type Sight,
  type StartMessage,
  type StateMessage,
  type StatusMessage,
  type TargetMarkMessage,
  type TrainingMessage,
  type ValueMessage,
  type ViewName,
  type WatchingMessage,
} from "../wire/messages";
import { type CellName, LEAD_VIEW, type PlaneName } from "../wire/views";
import { type BranchTree, buildTree } from "./airways";
import { caseKey } from "./case-key";
import type { Preview } from "./edit-preview";
import type { ExpertPath } from "./expert";
import { FIRST_FILM, type FilmChoice, type FilmFlight } from "./film";
import type { LiveAnswer } from "./live-path";
import type { ShownLayer } from "./lungs";
import { type Opening, openingAfter, openingWithout, openingWithPicture } from "./opening";
import { allUnderWay, type Local, type Optimistic, shown, underWay } from "./optimistic";
import { NO_PACE, type Pace } from "./pace";
import { NO_PACS, type PacsState, pacsAnswered, pacsClosed, pacsRequested } from "./pacs";
import { opensPanel, type PanelName, panelAfter, panelOf } from "./panels";
import type { PathCost } from "./path-search";
import { NOT_PLAYING, type Playing } from "./playing";
import { FIRST_PICTURE, type PictureChoice } from "./saved-picture";
import { AUTO_SPEED_MM_S } from "./speed";
import type { Step } from "./steps";
import { type Armed, FIRST_BRUSH_MM } from "./tools";
import type { TreePlace } from "./tree-index";
import { asVec3, type Vec3 } from "./vec";
import { FIRST_SHOWN, type ShownViews } from "./view-table";
import { addPick, type WallPoint } from "./wall-point";

/** The branch under the cursor in a view or list, with the position on the branch if it is known. */
export interface Hovered {
  readonly branchId: number;
  readonly place: TreePlace | null;
}

/** Position of the cursor: the view under the cursor, and the coordinates in that view, CSS px. */
export interface Cursor {
  readonly view: ViewName;
  readonly x: number;
  readonly y: number;
}

/** Status of the connection to the server. */
export interface Connection {
  readonly status: "connecting" | "open" | "lost" | "refused";
  /** Reason of a refused connection, as text for the user; null if there is none. */
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

/** Progress of the upload of files of a CT. */
export interface Upload {
  readonly sentBytes: number;
  readonly totalBytes: number;
  readonly numFiles: number;
}

/** State of the user interface that the server does not know. */
export interface Ui {
  readonly step: Step;
  /** Whether a voice of this computer speaks the feedback of an attempt. */
  readonly voiceOn: boolean;
  readonly full: CellName | null;
  /** The view that each cell of the window shows. */
  readonly shown: ShownViews;
  /** Whether a cell in full view shows its set of views side by side, if it has one. */
  readonly sideBySide: boolean;
  /** The plane under the cursor in the tri-plane view, which a drag would move; null without one. */
  readonly overPlane: PlaneName | null;
  readonly armed: Armed | null;
  /** Cost function of the path search to the next target. `pathStart` is the start point that the user has marked. */
  readonly pathCost: PathCost;
  readonly pathStart: Vec3 | null;
  /** Branch whose end (a fork) the user is moving with the fork tool; null if none. */
  readonly forkHeld: number | null;
  readonly brushMm: number;
  /** ID of the target whose boundary the brush changes; null if the brush edits no target. */
  readonly brushedTarget: string | null;
  readonly brushIsBall: boolean;
  /** Points of the current brush stroke, LPS mm. */
  readonly stroke: readonly Vec3[];
  readonly hovered: Hovered | null;
  /** The branch whose measurements the user has selected; null shows the last branch of the route. */
  readonly selected: number | null;
  /** ID of the branch that the user is renaming; null if none. */
  readonly renaming: number | null;
  readonly cursor: Cursor | null;
  /** The patient point under the cursor, LPS mm; null if the view cannot provide one. */
  readonly pointedLps: Vec3 | null;
  readonly keyCardOpen: boolean;
  /** Number of the current stop of the tour; null while no tour runs. */
  readonly tourAt: number | null;
  /** Index of the current hint that explains the window to a new user. */
  readonly hintAt: number;
  /** Whether the dialog that saves the case as a named file is open. */
  readonly saveOpen: boolean;
  /** Whether the dialog that compares the targets is open. */
  readonly comparisonOpen: boolean;
  /** Number of the flight whose score is shown; null if the dialog is closed. */
  readonly openScore: number | null;
  /** Path of the flight that is marked as the expert's; null until it is loaded. */
  readonly expertPath: { readonly flight: number; readonly path: ExpertPath } | null;
  /** Whether the dialog with the learning curves of the chosen learner is open. */
  readonly courseOpen: boolean;
  /** Number of the flight of the attempt that has just ended, until its score is known. */
  readonly awaitedScore: number | null;
  /** Whether the dialog with all cases and their disk usage is open. */
  readonly storageOpen: boolean;
  /** Whether the dialog that opens a series from a PACS is open. */
  readonly pacsOpen: boolean;
  /**
   * Time of the previous use, s, in the notice about a continued case that the user has closed; null if none was
   * closed.
   */
  readonly continuedReadS: number | null;
  /** The list that the left column shows. */
  readonly list: "airways" | "history";
  /** What the left column shows in a window that is too narrow for both: the list, or the panel of the step. */
  readonly panel: PanelName;
  /** Whether the left column, which is a sheet at the bottom of a touch screen, is open there. */
  readonly sheetOpen: boolean;
  /** Whether the panel of input devices replaces the panel of the step. */
  readonly devicesOpen: boolean;
  /** Whether the panel of key frames replaces the panel of the step. */
  readonly keysOpen: boolean;
  /** Speed of the automatic flight, mm/s. */
  readonly autoSpeedMmS: number;
  /** File suffix of the airway file that the server is generating for a download; null if none. */
  readonly making: string | null;
  /** Whether the airway view has locked the mouse pointer. */
  readonly mouseLocked: boolean;
  /** Availability of a VR headset in this browser; null until the browser has reported it. */
  readonly headset: "no-webxr" | "no-headset" | "ready" | "inside" | null;
  readonly routeLineVisible: boolean;
  /** The flight for whose video the dialog is open; null if it is closed. */
  readonly film: FilmFlight | null;
  readonly filmChoice: FilmChoice;
  /** Whether a video of this window is being rendered. */
  readonly filming: boolean;
  /** Whether the contact sheet of the route's forks is being rendered. */
  readonly makingForks: boolean;
  /** Size and marks of pictures that the user saves or copies. */
  readonly picture: PictureChoice;
  /** Whether slices and the cut-plane show the lumen outline and the centrelines. */
  readonly outlineVisible: boolean;
  /** Layers around the targets that the user has hidden. */
  readonly hiddenLayers: readonly ShownLayer[];
  readonly advancing: boolean;
  readonly cursorLps: Vec3 | null;
  /** Whether the live path leads to the pen, because the cursor rests while the pen moves. */
  readonly penLeads: boolean;
}

/** The complete state of the page. */
export interface AppState {
  readonly connection: Connection;
  readonly version: string | null;
  /** Whether this window only watches another user's workstation. */
  readonly watches: boolean;
  /** Whether this browser is on the machine that runs Carina; only there can a PACS be used. */
  readonly atMachine: boolean;
  /** Number of this window at the server, with which it requests pictures of its views as files. */
  readonly window: number;
  /** State of the watcher page and its current watchers; null in a window that itself watches. */
  readonly watching: WatchingMessage | null;
  /** Processor of the airway view that the user has chosen; null before the server states one. */
  readonly processor: ProcessorChoiceMessage | null;
  readonly start: StartMessage | null;
  readonly session: StateMessage | null;
  readonly tree: BranchTree | null;
  readonly route: RouteInfo | null;
  readonly pose: PoseMessage | null;
  readonly jobs: readonly ProgressMessage[];
  /** IDs of the jobs that this window has cancelled. */
  readonly cancelledJobs: readonly string[];
  readonly messages: readonly Message[];
  readonly nextMessageId: number;
  readonly status: StatusMessage | null;
  /** The cluster computers that render together with this one; null without a cluster. */
  readonly cluster: ClusterMessage | null;
  /** Points of the airway wall that the user has clicked in the airway view, oldest first. */
  readonly picks: readonly WallPoint[];
  /**
   * Header of the picture that each view's place shows. If another picture replaces a view's picture, its header is
   * stored at the replaced view.
   */
  readonly frames: Readonly<Partial<Record<ViewName, PictureHeader>>>;
  readonly pace: Pace;
  /**
   * Value of the voxel under the cursor from the server's latest answer; null while the cursor is outside the slices.
   */
  readonly probed: ValueMessage | null;
  /** The path to the cursor from the latest answer; null if no path is shown. */
  readonly livePath: LiveAnswer | null;
  /** What a click with the tool *Mark target* would mark, from the latest answer; null without an answer. */
  readonly targetMark: TargetMarkMessage | null;
  /** Preview of the edit that a click at the cursor would make; null without a tool with a preview. */
  readonly preview: Preview | null;
  /**
   * A branch that was not added because the CT shows no evidence; the page asks whether to draw it by hand. Null
   * without a question.
   */
  readonly doubt: NoEvidenceMessage | null;
  /** Measurements along a branch from the server's latest answer; null before the first answer. */
  readonly detail: BranchDetailMessage | null;
  readonly upload: Upload | null;
  /** Answers about the PACS; search results only while their dialog is open. */
  readonly pacs: PacsState;
  /** The CT that a job is opening; null without one. */
  readonly opening: Opening | null;
  /** Pictures of the series in the open CT's folder, PNG in base64, by key of the series. */
  readonly seriesPictures: Readonly<Record<string, string>>;
  /** Input devices from the server's latest message; null before the first message. */
  readonly devices: DevicesMessage | null;
  /** The tracked pen that moves the tip; null if no pen does. */
  readonly pen: PenMessage | null;
  /** The key frames, with the settings of the flight through them. */
  readonly keyFrames: KeyFramesMessage | null;
  /** Plans: targets with a size, their routes, and the instruments that can reach the targets. */
  readonly plans: PlansMessage | null;
  /** Lung structures that were mapped around the targets. */
  readonly lungs: LungsMessage | null;
  /** Flights that were recorded in the case. */
  readonly flights: readonly FlightInfo[];
  /** Tasks, the running attempt, and scores of flights; null until the server has sent them. */
  readonly training: TrainingMessage | null;
  /** Commands executed on the case, and the number of those that are not undone. */
  readonly history: HistoryMessage | null;
  /** Playback of the flight through the key frames. */
  readonly playing: Playing;
  /** Number of the recorded flight that is or was last replayed; null if none was. */
  readonly flownFlight: number | null;
  /** Playback of the recorded flight. */
  readonly replaying: Playing;
  /** Measured speed of the tip, mm/s; null while the tip does not move. */
  readonly speedMmS: number | null;
  readonly ui: Ui;
  /**
   * Display settings of the airway view (instrument, outline, field of view): the server's, with unsent changes of this
   * page.
   */
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
  atMachine: false,
  window: 0,
  watching: null,
  processor: null,
  start: null,
  session: null,
  tree: null,
  route: null,
  pose: null,
  jobs: [],
  cancelledJobs: [],
  messages: [],
  nextMessageId: 1,
  status: null,
  cluster: null,
  picks: [],
  frames: {},
  pace: NO_PACE,
  probed: null,
  livePath: null,
  targetMark: null,
  preview: null,
  doubt: null,
  detail: null,
  upload: null,
  pacs: NO_PACS,
  opening: null,
  seriesPictures: {},
  devices: null,
  pen: null,
  keyFrames: null,
  plans: null,
  lungs: null,
  flights: [],
  training: null,
  history: null,
  playing: NOT_PLAYING,
  flownFlight: null,
  replaying: NOT_PLAYING,
  speedMmS: null,
  ui: {
    step: "open",
    voiceOn: false,
    full: null,
    shown: FIRST_SHOWN,
    sideBySide: false,
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
    tourAt: null,
    hintAt: 0,
    saveOpen: false,
    comparisonOpen: false,
    openScore: null,
    courseOpen: false,
    expertPath: null,
    awaitedScore: null,
    storageOpen: false,
    pacsOpen: false,
    continuedReadS: null,
    list: "airways",
    panel: "list",
    sheetOpen: true,
    devicesOpen: false,
    keysOpen: false,
    autoSpeedMmS: AUTO_SPEED_MM_S,
    making: null,
    mouseLocked: false,
    headset: null,
    routeLineVisible: true,
    film: null,
    filmChoice: FIRST_FILM,
    filming: false,
    makingForks: false,
    picture: FIRST_PICTURE,
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

/** An event that changes the state of the page. */
export type AppEvent =
  | { kind: "server"; message: ServerMessage }
  /** A command was sent; `number` is its number on this connection. */
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

/** Initial values of the server's answers that are valid only for one case and one connection. */
const NOTHING_SHOWN = { livePath: null, targetMark: null, preview: null, doubt: null, detail: null } as const;

/** Interface state with no active tool and nothing under the cursor. */
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

/** Path search of a new case: cost function lumen, and no marked start point. */
const FIRST_SEARCH = { pathCost: "lumen", pathStart: null } as const;

/** Return the state after an event; the given state is not changed. */
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
      return hasSameSpeed(event.pace, state.pace) ? state : { ...state, pace: event.pace };
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
        // The names of patients leave the page with the dialog, also without a connection to the server.
        pacs: event.change.pacsOpen === false ? pacsClosed(state.pacs) : state.pacs,
        // A change of the step closes the panel of key frames, so that the panel of the step is visible.
        ui: {
          ...state.ui,
          keysOpen: event.change.step === undefined && state.ui.keysOpen,
          panel: panelAfter(state.ui, event.change),
          sheetOpen: state.ui.sheetOpen || opensPanel(event.change),
          ...event.change,
        },
      };
  }
}

function receive(state: AppState, message: ServerMessage): AppState {
  switch (message.type) {
    case "hello":
      return {
        ...state,
        version: message.carina_version,
        watches: message.watches,
        window: message.window,
        atMachine: message.at_machine,
      };
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
      // Discard an answer that arrives after the cursor has left the slices.
      return state.ui.cursorLps === null ? state : { ...state, probed: message };
    case "picked":
    case "live_path":
    case "edit_preview":
      // Leave the state unchanged: the workstation decides whether the answer is still needed, and then dispatches it.
      return state;
    case "target_mark":
      return { ...state, targetMark: message };
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
      return {
        ...state,
        jobs: state.jobs.filter((job) => job.job_id !== message.job_id),
        opening: openingWithout(state.opening, message.job_id),
      };
    case "opening":
      return { ...state, opening: openingAfter(state.opening, message, state.cancelledJobs) };
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
    case "training":
      return trainingChanged(state, message);
    case "history":
      return { ...state, history: message };
    case "processor_choice":
      return { ...state, processor: message };
    case "watching":
      return { ...state, watching: message };
    case "cluster":
      return { ...state, cluster: message };
    case "series_picture":
      return message.list_id !== null
        ? { ...state, opening: openingWithPicture(state.opening, message) }
        : { ...state, seriesPictures: { ...state.seriesPictures, [message.key]: message.picture } };
    case "pacs_connections":
    case "pacs_test":
    case "pacs_studies":
    case "pacs_series":
    case "pacs_preview":
    case "pacs_sent":
      return { ...state, pacs: pacsAnswered(state.pacs, message, state.ui.pacsOpen) };
    case "pacs_problem":
      // A retrieval continues while the dialog is closed, so its failure is shown as an error.
      return message.task === "get" && !state.ui.pacsOpen
        ? say(state, { kind: "error", code: message.code, message: message.problem, action: null })
        : { ...state, pacs: pacsAnswered(state.pacs, message, state.ui.pacsOpen) };
  }
}

/** Return the state after a change of the training; after an attempt the score of its flight is opened. */
function trainingChanged(state: AppState, training: TrainingMessage): AppState {
  const before = state.training?.running ?? null;
  const wasBusy = before !== null || (state.training?.quiz ?? null) !== null;
  const begins = !wasBusy && (training.running !== null || training.quiz !== null);
  const awaited = training.running === null && before !== null ? before.flight : state.ui.awaitedScore;
  const isScored = awaited !== null && training.scores.some((score) => score.flight === awaited);
  // A teacher's page shows the learners as soon as they are shared.
  const isTeacher = training.classroom.length > 0 && (state.training?.classroom ?? []).length === 0;
  const ui: Ui = {
    ...state.ui,
    awaitedScore: isScored || training.running !== null ? null : awaited,
    openScore: training.running === null && isScored ? awaited : state.ui.openScore,
    // The layout of an attempt or a quiz contains the airway view, which a full view of another picture would replace.
    full: begins ? null : state.ui.full,
    tourAt: begins ? null : state.ui.tourAt,
    // A page that was reloaded, or another window, shows the step of the attempt, also after its end.
    step: begins ? "train" : state.ui.step,
    panel: begins || isTeacher ? panelOf("train") : state.ui.panel,
  };
  return { ...state, training, ui };
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
      training: null,
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
        film: null,
        advancing: false,
        keysOpen: false,
        saveOpen: false,
        comparisonOpen: false,
        openScore: null,
        courseOpen: false,
        expertPath: null,
        awaitedScore: null,
        tourAt: null,
        step: "open",
      },
    };
  } else if (now !== null && caseKey(state.session) !== caseKey(session)) {
    const hasFindings = now.quality.length + now.warnings.length > 0 || !now.is_hu;
    const ui: Ui = {
      ...next.ui,
      ...NOTHING_HELD,
      ...FIRST_SEARCH,
      film: null,
      pacsOpen: false,
      step: hasFindings ? "check" : "airways",
      panel: panelOf(hasFindings ? "check" : "airways"),
    };
    next = {
      ...next,
      ...NOTHING_SHOWN,
      frames: {},
      picks: [],
      local: NOTHING_LOCAL,
      opening: null,
      seriesPictures: {},
      ui,
    };
    // The series was retrieved and opened, so the search results with names are no longer needed.
    next = { ...next, pacs: { ...NO_PACS, connections: next.pacs.connections } };
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
  const isUnchanged =
    now.pathMm === local.pathMm &&
    numberOf(now.look) === numberOf(local.look) &&
    numberOf(now.sight) === numberOf(local.sight);
  if (isUnchanged || session === null) return state;
  return { ...state, local: now, look: shown(now.look, session.look), sight: shown(now.sight, session.sight) };
}

const numberOf = (values: object): number => Object.keys(values).length;

/** Return the state with a new tree; IDs of branches that no longer exist are cleared. */
function treeChanged(state: AppState, tree: BranchTree | null): AppState {
  const ifInTree = (id: number | null): number | null => (id !== null && tree?.byId.has(id) === true ? id : null);
  const { ui } = state;
  return {
    ...state,
    tree,
    detail: null,
    ui: {
      ...ui,
      hovered: null,
      selected: ifInTree(ui.selected),
      forkHeld: ifInTree(ui.forkHeld),
      renaming: ifInTree(ui.renaming),
    },
  };
}

/**
 * Return the ID of the branch whose measurements are shown: the selected branch, else that of the route; null if none.
 */
export function shownBranch(state: AppState): number | null {
  return state.ui.selected ?? state.route?.spans.at(-1)?.branch_id ?? null;
}

function poseChanged(state: AppState, pose: PoseMessage): AppState {
  return state.pose !== null && pose.pose_id < state.pose.pose_id ? state : { ...state, pose };
}

/** Return the state with the result that a command is expected to have, before the server answers. */
function foresee(state: AppState, message: ClientMessage, number: number): AppState {
  switch (message.type) {
    case "undo":
    case "redo":
      // The command restores an earlier look, so the sent settings of the look no longer apply.
      return { ...state, doubt: null, local: { ...state.local, look: {} } };
    case "set_scope":
      // The command sets the field of view and the outline of the scope, so the sent settings of the look no longer
      // apply.
      return { ...state, local: { ...state.local, look: {} } };
    case "edit_tree":
    case "set_root":
      // The question concerned the tree before this command, or this command answers the question.
      return { ...state, doubt: null };
    case "go_to":
      return { ...state, local: { ...state.local, pathMm: { value: message.path_mm, number } } };
    case "steer":
    case "next_fork":
    case "previous_fork":
    case "place":
      return state.local.pathMm === null ? state : { ...state, local: { ...state.local, pathMm: null } };
    case "test_pacs":
    case "search_pacs":
    case "ask_pacs_series":
    case "get_pacs_series":
    case "save_pacs":
    case "remove_pacs":
    case "empty_pacs":
    case "send_plan_to_pacs":
    case "stop_pacs":
      return { ...state, pacs: pacsRequested(state.pacs, message) };
    case "cancel":
      return {
        ...state,
        cancelledJobs: [...state.cancelledJobs, message.job_id],
        opening: openingWithout(state.opening, message.job_id),
      };
    case "accept_notice":
      return state.start === null ? state : { ...state, start: { ...state.start, notice_accepted: true } };
    case "read_hints":
      return state.start === null ? state : { ...state, start: { ...state.start, hints_read: true } };
    default:
      return message.type in SETS ? fieldSet(state, message as FieldSetting, number) : state;
  }
}

type FieldSetting = Extract<ClientMessage, { type: keyof typeof SETS }>;

/** Return the state with a setting of look or sight at the sent value, until the server has executed the command. */
function fieldSet(state: AppState, message: FieldSetting, number: number): AppState {
  const { of, field, from, by_view } = SETS[message.type];
  const { type: _, view, ...fields } = message as { type: string; view?: string } & Record<string, unknown>;
  const sentValue = from === null ? fields : fields[from];
  const before = state[of] as unknown as Record<string, object>;
  const value = by_view && view !== undefined ? { ...before[field], [view]: sentValue } : sentValue;
  return {
    ...state,
    [of]: { ...before, [field]: value },
    local: { ...state.local, [of]: { ...state.local[of], [field]: { value, number } } },
  };
}

function connectionChanged(state: AppState, connection: Connection): AppState {
  // Clear the jobs of a lost connection, which receives no further updates; the new connection reports its own jobs.
  const jobs = connection.status === "open" || connection.status === "connecting" ? state.jobs : [];
  // Clear the pose for a new connection: a restarted server numbers poses from the start, and its first pose must be accepted.
  const pose = connection.status === "open" ? null : state.pose;
  const opening = jobs === state.jobs ? state.opening : null;
  return {
    ...state,
    connection,
    jobs,
    opening,
    pose,
    pen: null,
    local: NOTHING_LOCAL,
    ui: { ...state.ui, advancing: false },
  };
}

/** Maximum number of notices in the list; older notices are removed. Errors stay until the user closes them. */
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

const hasSameSpeed = (a: Pace, b: Pace): boolean =>
  a.fps === b.fps && a.ageMs === b.ageMs && a.waitingMs === b.waitingMs;

/** Return the position of the tip in the latest pose, LPS mm; null without a pose. */
export function tipLps(state: AppState): Vec3 | null {
  const m = state.pose?.lps_from_camera;
  return m === undefined ? null : [m[3] ?? 0, m[7] ?? 0, m[11] ?? 0];
}

/**
 * Return the point that the button of the active pen marks, LPS mm: the tip of the pen, or the tip of the scope if the
 * pen's is unknown. Null if no pen moves the tip.
 */
export function penPoint(state: AppState): Vec3 | null {
  if (state.pen === null) return null;
  return state.pen.lps === null ? tipLps(state) : asVec3(state.pen.lps);
}

/**
 * Return the point where the slices intersect, LPS mm, including a drag in progress; null if the slices follow the tip.
 */
export function crosshairLps(state: AppState): Vec3 | null {
  return asPoint(state.sight.crosshair_lps);
}

/** Return the instrument whose optics the airway view uses; null for a pinhole camera. */
export function scopeOf(state: AppState): Scope | null {
  return state.start?.scopes.find((scope) => scope.name === state.look.scope) ?? null;
}

const LUNG_WINDOW: GreyWindow = { width_hu: 1500, level_hu: -600 };

/** Return the window width and level of the slices, in HU. */
export function greyWindow(state: AppState): GreyWindow {
  return state.sight.window ?? LUNG_WINDOW;
}

/** Return the tip's position along the route, mm, including a drag of the slider in progress; null off the route. */
export function pathMm(state: AppState): number | null {
  return state.local.pathMm?.value ?? state.pose?.path_mm ?? null;
}

/** Return whether the airway view is on the screen: no other view is in full view. */
export const isLeadShown = ({ ui }: Pick<AppState, "ui">): boolean => ui.full === null || ui.full === LEAD_VIEW;

/** Return whether the user is choosing a target, for which the slices are enlarged; a view in full size stays. */
export const choosesTargetIn = (ui: Ui): boolean => ui.step === "target" && ui.full === null;
