/**
 * The workstation: connects stream, views, state, flight and keys. Panels call its methods; the workstation does not
 * depend on panels.
 */

import { KeyPlayer, keyFrameHooks } from "../input/key-frame-player";
import { listenToKeys } from "../input/keyboard";
import { type Action, WINDOWS } from "../input/keymap";
import { Steering } from "../input/steering";
import { TRAINING_ACTIONS } from "../input/training-actions";
import { WATCHERS_ACTIONS } from "../input/watchers-actions";
import { PictureBoard } from "../net/pictures";
import { Stream, type StreamStatus } from "../net/stream";
import { mainLeaf, neighbourBranch } from "../state/airways";
import {
  type AppState,
  crosshairLps,
  INITIAL_STATE,
  isLeadShown,
  pathMm,
  shownBranch,
  tipLps,
  type Ui,
} from "../state/app-state";
import { routeDoubts } from "../state/branch-text";
import { caseKey } from "../state/case-key";
import { forkAhead } from "../state/fork";
import { hintsDue, TOUR } from "../state/guide";
import { type ShownLayer, toggled, wantedLayers } from "../state/lungs";
import { NOT_SENT } from "../state/optimistic";
import { PaceMeter } from "../state/pace";
import { panelOf } from "../state/panels";
import { type PathCost, startOf, targetMessage } from "../state/path-search";
import { wasUsedByPen } from "../state/pen";
import { planOf } from "../state/plan";
import type { PixelPoint } from "../state/projection";
import { clampToRoute } from "../state/route";
import { SpeedMeter, shownSpeed } from "../state/speed";
import { Store } from "../state/store";
import { type Armed, isBrush, isLesionBrush, type LesionTool, nextBrush, wantsBranch } from "../state/tools";
import { attemptOf, trainingLayout } from "../state/training";
import { asVec3, cameraFromMatrix, type Vec3 } from "../state/vec";
import { nextIn, showing, viewZoomedBy } from "../state/view-table";
import type { WallPoint } from "../state/wall-point";
import { mayWatcherSend } from "../state/watching";
import { sceneOf } from "../views/scene";
import { Wall } from "../views/wall";
import type {
  Carm,
  ClientMessage,
  Demo,
  FlightInfo,
  Outline,
  PickedMessage,
  PictureHeader,
  PoseMessage,
  QuizInfo,
  ViewName,
} from "../wire/messages";
import { type CellName, LEAD_VIEW, VIEWS } from "../wire/views";
import { BrowserDevices } from "./devices";
import { FileTransfers } from "./file-transfers";
import { FilmFiles } from "./film-files";
import { PictureFiles } from "./picture-files";
import { Pointing } from "./pointing";
import { Previewing } from "./previewing";
import { atNextRefresh } from "./refresh";
import { RefreshScheduler, wakeOnInput } from "./refresh-scheduler";
import type { Station } from "./station";
import { asConnection, SLABS } from "./station-parts";

/** Duration, s, of the flight before an event from which the event's replay begins. */
const REPLAY_BEFORE_S = 3;
/** Movement along the route by one press of an arrow key on the ruler, mm. */
const STEP_MM = 2;
/** Interval at which frame rate and latency are shown, ms. */
const PACE_MS = 500;
/** Interval at which the speed of the tip is shown, ms. */
const SPEED_MS = 250;

/** Controller of the page that connects the stream, the views, the state and the input. */
export class Workstation implements Station {
  readonly store = new Store(INITIAL_STATE, atNextRefresh);
  readonly wall: Wall;
  readonly flight: Steering;
  readonly player: KeyPlayer;
  /** Player of recorded flights. */
  readonly replayer: KeyPlayer;
  #flownFlight: number | null = null;
  readonly pointing: Pointing;
  readonly previewing: Previewing;
  readonly devices: BrowserDevices;
  readonly pictures = new PictureFiles(this);
  readonly films = new FilmFiles(this);
  readonly transfers = new FileTransfers(this);
  readonly #stream: Stream;
  readonly #board: PictureBoard<ImageBitmap>;
  /**
   * Latest message of each kind whose earlier values are obsolete. The messages are sent at the next display refresh.
   */
  readonly #soon = new Map<string, ClientMessage>();
  #autoWanted = false;
  #pickId = 0;
  #outline: Outline = "round";
  #pickForgotten = 0;
  readonly #pace = new PaceMeter();
  readonly #speed = new SpeedMeter();
  readonly #heart = new RefreshScheduler((elapsedS) => this.#tick(elapsedS), {
    nowMs: () => performance.now(),
    nextRefresh: (call) => {
      const refresh = requestAnimationFrame(call);
      return () => cancelAnimationFrame(refresh);
    },
    after: (ms, call) => {
      const timer = setTimeout(call, ms);
      return () => clearTimeout(timer);
    },
    needsEveryRefresh: () => this.#needsEveryRefresh(),
  });

  constructor(connect: () => WebSocket, token: string | null) {
    this.#board = new PictureBoard<ImageBitmap>({
      decode: ({ header, payload }) => createImageBitmap(new Blob([payload], { type: `image/${header.codec}` })),
      draw: (header, image, outline, layers) => {
        // A picture of a view that has left the screen is not stored in the state, because the picture would be
        // outdated when the view returns.
        if (!this.wall.draw(header, image, outline, layers)) return;
        // Only pictures of the airway view count for its frame rate, not those of the viewfinder that replaces it.
        if (header.view === LEAD_VIEW) this.#pace.pictureDrawn(header.pose_id, performance.now());
        else if (header.stands_for === LEAD_VIEW) this.#pace.placeholderDrawn(header.pose_id);
        this.store.dispatch({ kind: "picture", header });
        this.pointing.pictureDrawn(header.stands_for ?? header.view);
      },
      acknowledge: (frameId) => this.#stream.send({ type: "ack", frame_id: frameId }),
      failed: (header) =>
        this.#showError("picture", `The ${header.view} image could not be read.`, "The next image replaces it."),
    });
    this.wall = new Wall({
      scene: () => sceneOf(this.store.get()),
      layoutChanged: (views) => void this.#stream.send({ type: "layout", views }),
      isSeen: () => !document.hidden || this.state.ui.headset === "inside",
      nextRefresh: (task) => void requestAnimationFrame(task),
    });
    this.flight = new Steering({
      route: () => this.state.route,
      pathMm: () => pathMm(this.state),
      speedMmS: () => this.state.ui.autoSpeedMmS,
      send: (message) => {
        this.pausePlaying();
        this.send(message);
      },
      advancing: (on) => this.ui({ advancing: on }),
    });
    this.player = new KeyPlayer(
      keyFrameHooks(
        () => this.state.keyFrames,
        (message) => this.send(message),
        (playing) => this.store.dispatch({ kind: "playing", playing }),
      ),
    );
    this.replayer = new KeyPlayer({
      durationS: () => this.#selectedFlight()?.length_s ?? 0,
      stops: () => [],
      fly: (time_s, goes_on) =>
        this.#flownFlight !== null && this.send({ type: "fly_flight", number: this.#flownFlight, time_s, goes_on }),
      timeOf: ({ flight }) => (flight !== null && flight.number === this.#flownFlight ? flight.time_s : null),
      waits: true,
      changed: (replaying) => this.store.dispatch({ kind: "replaying", flownFlight: this.#flownFlight, replaying }),
    });
    this.previewing = new Previewing(this);
    this.pointing = new Pointing(this, this.previewing);
    this.devices = new BrowserDevices(this, this.pointing);
    this.#stream = new Stream(
      connect,
      {
        status: (status) => this.#connectionChanged(status),
        message: (message) => {
          const before = this.state;
          if (message.type === "pose") this.#pace.poseArrived(message.pose_id, performance.now());
          this.store.dispatch({ kind: "server", message });
          if (message.type === "pose") this.#onPose(message);
          if (message.type === "key_frames") this.player.limitDuration(message.duration_s);
          if (message.type === "flights") this.replayer.limitDuration(this.#selectedFlight()?.length_s ?? 0);
          if (message.type === "error") this.replayer.stopIfUnanswered();
          if (message.type === "picked") this.#picked(message);
          if (message.type === "route") this.#warnOfDoubts();
          if (message.type === "live_path") this.pointing.receive(message);
          if (message.type === "edit_preview") this.previewing.receive(message);
          if (message.type === "tree") this.previewing.again();
          if (message.type === "no_evidence") this.#showDoubtStep();
          if (message.type === "state" && wasUsedByPen(before.ui.armed, before.session, message)) this.disarm();
          // In another case the numbers of frames and poses may start again below those of the previous case, so the
          // queues are cleared.
          if (message.type === "state" && caseKey(before.session) !== caseKey(message)) {
            this.#board.reset();
            this.#pace.reset();
            this.#speed.reset();
            this.wall.clear();
            this.disarm();
          }
        },
        picture: (picture) => this.#board.receive(picture),
        fault: (words) =>
          this.#showError(
            "protocol",
            `Carina sent a message that this page cannot read: ${words}.`,
            "Reload the page.",
          ),
      },
      {
        nowMs: () => performance.now(),
        after: (ms, call) => {
          const timer = setTimeout(call, ms);
          return () => clearTimeout(timer);
        },
      },
      token,
    );
  }

  get state(): AppState {
    return this.store.get();
  }

  /** Start the refreshScheduler, the connection and all listeners; return a function that stops them. */
  start(): () => void {
    const stopKeys = listenToKeys(window, {
      press: (action) => this.act(action),
      hold: (axis, sign, down) => this.flight.hold(axis, sign, down),
      slow: (on) => this.flight.slow(on),
      isAvailable: (action) => this.#isAvailable(action),
      inTask: () => attemptOf(this.state) !== null,
      holdsTool: () => this.state.ui.armed !== null || this.state.doubt !== null,
      arrowsLook: () => this.state.session?.mode !== "path",
      enabled: () => this.state.session?.case != null && this.state.start?.notice_accepted !== false,
    });
    const stopTouch = this.store.subscribe(() => this.wall.touch());
    const seenOrNot = (): void => this.wall.sendLayout(false);
    document.addEventListener("visibilitychange", seenOrNot);
    this.#heart.start();
    const stopWaking = wakeOnInput(window, this.#heart.wake);
    const counter = setInterval(() => {
      // The pictures of a covered airway view are not late.
      if (!isLeadShown(this.state)) this.#pace.reset();
      this.store.dispatch({ kind: "pace", pace: this.#pace.read(performance.now()) });
    }, PACE_MS);
    const speed = setInterval(() => {
      this.store.dispatch({ kind: "speed", speedMmS: shownSpeed(this.#speed.read(performance.now())) });
    }, SPEED_MS);
    this.#stream.open();
    this.devices.watchHeadset();
    void this.films.resume();
    return () => {
      stopKeys();
      stopTouch();
      document.removeEventListener("visibilitychange", seenOrNot);
      this.devices.stop();
      stopWaking();
      this.#heart.stop();
      clearInterval(counter);
      clearInterval(speed);
      this.#stream.close();
    };
  }

  reconnect = (): void => this.#stream.open();

  /** Send a message now, and show its expected result before the server answers. */
  send = (message: ClientMessage): boolean => {
    if (this.state.watches && !mayWatcherSend(message)) return false;
    if (!this.#stream.send(message)) return false;
    this.store.dispatch({ kind: "sent", message, number: this.#stream.numCommands });
    return true;
  };

  /**
   * Send the latest message of its kind at the next display refresh, and show its expected result before the server
   * answers.
   */
  sendSoon(message: ClientMessage): void {
    if (this.state.watches && !mayWatcherSend(message)) return;
    const kind = "view" in message ? `${message.type} ${message.view}` : message.type;
    this.#soon.set(kind, message);
    this.#heart.wake();
    this.store.dispatch({ kind: "sent", message, number: NOT_SENT });
  }

  ui(change: Partial<Ui>): void {
    this.store.dispatch({ kind: "ui", change });
  }

  notice(message: string): void {
    this.store.dispatch({ kind: "say", message: { kind: "notice", code: "notice", message, action: null } });
  }

  // ------------------------------------------------------------------ cases

  openPath = (path: string): void => void this.send({ type: "open_path", path });
  /** Open the dialog that opens a series from a PACS. */
  openPacs = (): void => {
    this.send({ type: "ask_pacs" });
    this.ui({ pacsOpen: true });
  };

  /** Close the dialog; its search stops, and the names of patients leave this page. */
  closePacs = (): void => {
    this.send({ type: "stop_pacs" });
    this.ui({ pacsOpen: false });
  };

  openDemo = (name: Demo["name"]): void => void this.send({ type: "open_demo", name });

  /** Write the named file of the case; open the save dialog if the case has no named file. */
  save(): void {
    const saving = this.state.session?.saving;
    if (saving?.keeps !== true)
      this.notice("This case was not opened from a folder or file on this machine, so it is not saved.");
    else if (saving.copy_name === null || saving.copy_conflict !== null) this.ui({ saveOpen: true });
    else this.send({ type: "save_case" });
  }

  // ------------------------------------------------------------------ flight

  goTo = (mm: number): void => {
    const { route } = this.state;
    if (route === null) return;
    this.flight.stopAuto();
    this.sendSoon({ type: "go_to", path_mm: clampToRoute(route, mm) });
  };

  stepAlong = (sign: 1 | -1): void => {
    const at = pathMm(this.state);
    if (at !== null) this.goTo(at + sign * STEP_MM);
  };

  /** Add the present pose as the last key frame, and show the list of key frames. */
  addKey(): void {
    this.send({ type: "edit_key_frames", edit: { kind: "add" } });
    this.#showKeys(true);
  }

  /** Show or hide the panel of key frames, which replaces the panel of the step or of the devices. */
  #showKeys(keysOpen: boolean): void {
    if (keysOpen && this.state.ui.devicesOpen) this.toggleDevices();
    this.ui({ keysOpen });
  }

  /** Play or pause the flight through the key frames. */
  playKeys(): void {
    this.flight.stopAuto();
    this.replayer.pause();
    this.player.toggle();
  }

  /** Play or pause a recorded flight. */
  playFlight(number: number): void {
    this.flight.stopAuto();
    this.player.pause();
    if (this.#flownFlight !== number) {
      this.#flownFlight = number;
      this.replayer.resetToStart();
    }
    this.replayer.toggle();
  }

  /** Begin an attempt at a task of the training. */
  startTask(task: string): void {
    this.flight.stopAuto();
    this.pausePlaying();
    this.disarm();
    this.send({ type: "start_task", task });
  }

  /** Pause the attempt, or continue it. */
  pauseTask = (): void => {
    const running = this.state.training?.running ?? null;
    if (running !== null) this.send({ type: "pause_task", paused: !running.paused });
  };

  /** Begin a quiz with questions in a new random order. */
  startQuiz(kind: QuizInfo["kind"]): void {
    this.flight.stopAuto();
    this.pausePlaying();
    this.disarm();
    this.send({ type: "start_quiz", kind, seed: Math.floor(Math.random() * 2 ** 31) });
  }

  /** Replay a flight from a few seconds before an event. */
  replayMoment(flight: number, atS: number): void {
    this.ui({ openScore: null });
    if (this.#flownFlight !== flight) this.playFlight(flight);
    this.replayer.seek(Math.max(atS - REPLAY_BEFORE_S, 0));
    if (!this.state.replaying.on) this.playFlight(flight);
  }

  #selectedFlight(): FlightInfo | null {
    return this.state.flights.find((flight) => flight.number === this.#flownFlight) ?? null;
  }

  /** Pause the playback now, without waiting for the server's answer, because the user moves the tip. */
  pausePlaying(): void {
    this.player.pause();
    this.replayer.pause();
  }

  #onPose(pose: PoseMessage): void {
    const tip = tipLps(this.state);
    if (tip !== null) this.#speed.poseArrived(tip, performance.now());
    this.player.poseArrived(pose);
    this.replayer.poseArrived(pose);
    // Movement by an input device stops the automatic flight.
    if (pose.by_device) this.flight.stopAuto();
  }

  toFork = (which: "next" | "previous"): void => {
    this.flight.stopAuto();
    this.send({ type: which === "next" ? "next_fork" : "previous_fork" });
  };

  chooseBranch = (branchId: number): void => {
    this.ui({ selected: branchId });
    this.send({ type: "choose_route", target_id: null, branch_id: branchId });
  };
  /** Select a planned route of a target, and go to the Route step. */
  takePlannedRoute = (targetId: string, number: number): void => {
    this.send({ type: "choose_planned_route", target_id: targetId, number });
    this.ui({ step: "route" });
  };

  /**
   * Choose a target of the comparison, and show its route: the best one, or the chosen one if the target is chosen
   * already.
   */
  chooseComparedTarget(targetId: string): void {
    this.ui({ comparisonOpen: false, step: "route" });
    if (this.state.route?.target_id === targetId) return;
    if (planOf(this.state.plans, targetId) === null) this.chooseTarget(targetId);
    else this.takePlannedRoute(targetId, 1);
  }

  /** Show the X-ray from the C-arm at these angles, in full view if another cell has the full view. */
  showFromCArm({ primary_deg, secondary_deg }: Pick<Carm, "primary_deg" | "secondary_deg">): void {
    const view = viewZoomedBy("carm");
    this.show(view);
    if (this.state.ui.full !== null) this.ui({ full: VIEWS[view].cell });
    this.sendSoon({ type: "set_carm", ...this.state.sight.carm, primary_deg, secondary_deg, mm_per_px: null });
  }

  /** Show or hide a layer around the targets. The server sends no data of hidden layers with the pictures. */
  toggleLayer(layer: ShownLayer): void {
    this.ui({ hiddenLayers: toggled(this.state.ui.hiddenLayers, layer) });
    this.#sendLayers();
  }

  #sendLayers(): void {
    if (!this.state.watches)
      this.#stream.send({ type: "set_layers", layers: wantedLayers(this.state.ui.hiddenLayers) });
  }

  chooseTarget = (targetId: string): void =>
    void this.send({ type: "choose_route", target_id: targetId, branch_id: null });

  /** Request the wall point at a pixel of the displayed airway picture. */
  pickWall(header: PictureHeader, at: PixelPoint): void {
    if (at.column < 0 || at.row < 0 || at.column > header.width || at.row > header.height) return;
    this.#pickId += 1;
    this.send({ type: "pick", pick_id: this.#pickId, frame_id: header.frame_id, ...at });
  }

  /** Restore the state before the first click of a double click. */
  restoreBeforeClick(before: { picks: readonly WallPoint[]; crosshair: Vec3 | null; selected: number | null }): void {
    this.#pickForgotten = this.#pickId;
    if (this.state.picks !== before.picks) this.store.dispatch({ kind: "picks", picks: before.picks });
    if (crosshairLps(this.state) !== before.crosshair) {
      this.sendSoon({ type: "set_crosshair", lps: before.crosshair });
    }
    this.ui({ selected: before.selected });
  }

  #picked(message: PickedMessage): void {
    if (message.pick_id <= this.#pickForgotten) return;
    if (message.lps === null) {
      this.notice("No wall here: the scan ends in this direction.");
      return;
    }
    const lps = asVec3(message.lps);
    if (this.state.ui.armed === null) {
      this.store.dispatch({ kind: "picked", message });
      if (message.branch_id !== null) this.ui({ selected: message.branch_id });
    }
    this.pick(lps);
  }

  /** Handle a click at a patient point: apply the active tool, or move the crosshair if no tool is active. */
  pick(lps: Vec3): void {
    if (this.state.ui.armed === null) this.sendSoon({ type: "set_crosshair", lps });
    else this.pointing.commit(lps);
  }

  /** Activate a tool (such as cut or bridge), or deactivate it if it is already active. */
  arm(tool: Armed): void {
    const { armed } = this.state.ui;
    this.pointing.forget();
    this.answerDoubt(false);
    const step = tool === "target" || tool === "start" || isLesionBrush(tool) ? "target" : "airways";
    // The panel contains the instruction of the tool; a tool for branches is also applied to rows of the list.
    const panel = wantsBranch(tool, false) ? this.state.ui.panel : "step";
    this.ui({ armed: armed === tool ? null : tool, forkHeld: null, renaming: null, step, panel });
  }

  /** Activate the brush for a target's boundary. */
  brushTarget(targetId: string, tool: LesionTool): void {
    if (this.state.ui.armed !== tool || this.state.ui.brushedTarget === targetId) this.arm(tool);
    this.ui({ brushedTarget: targetId });
  }

  /**
   * Select the cost function for the paths to further targets. If the function needs a start point, activate the tool
   * that marks one.
   */
  choosePathCost(cost: PathCost): void {
    this.ui({ pathCost: cost });
    this.pointing.forget();
    if (cost !== "lumen" && startOf(this.state.ui, this.state.session) === null && this.state.ui.armed !== "start")
      this.arm("start");
    else if (cost === "lumen" && this.state.ui.armed === "start") this.disarm();
  }

  /** Add a target with the selected cost function; show an error if the function needs a start point and has none. */
  addTarget(lps: Vec3): void {
    const message = targetMessage(lps, this.state.ui, this.state.session);
    if (message === null) this.notice("Mark the start point first: there are no segmented airways to start from.");
    else this.send(message);
  }

  disarm(): void {
    this.pointing.forget();
    this.answerDoubt(false);
    this.ui({ armed: null, forkHeld: null });
  }

  /** Go to a step and deactivate the tool of the previous step. */
  toStep(step: Ui["step"]): void {
    // An attempt shows the step *Train* until it ends.
    if (trainingLayout(this.state) !== undefined) return;
    if (step !== this.state.ui.step) this.disarm();
    this.ui({ step, panel: panelOf(step) });
  }

  /**
   * Show a stop of the tour, with its step; null, or a number past the last stop, ends the tour and
   * restores the step before it.
   */
  tourTo(at: number | null): void {
    const { tourAt, step } = this.state.ui;
    if (tourAt === null) this.#stepBeforeTour = step;
    const next = at === null ? undefined : TOUR[at];
    this.toStep(next?.step ?? (next === undefined ? this.#stepBeforeTour : step));
    this.ui({ tourAt: next === undefined ? null : at, keyCardOpen: false, devicesOpen: false, full: null });
  }

  #stepBeforeTour: Ui["step"] = "airways";

  /** End the tour, or close the hints if they have the focus; return false if neither is shown. */
  #leaveGuide(): boolean {
    if (this.state.ui.tourAt !== null) {
      this.tourTo(null);
      return true;
    }
    if (!hintsDue(this.state) || document.activeElement?.closest(".guide-card") == null) return false;
    return this.send({ type: "read_hints" });
  }

  /**
   * Cancel the first of these that exists: the open question, the fork that is being moved, the active tool. Return
   * false if none exists.
   */
  putToolAway(): boolean {
    const { armed, forkHeld } = this.state.ui;
    if (this.state.doubt !== null) {
      this.answerDoubt(false);
      return true;
    }
    if (armed === null) return false;
    if (forkHeld === null) this.disarm();
    else {
      this.pointing.forget();
      this.ui({ forkHeld: null });
    }
    return true;
  }

  /** Show the step whose panel contains the question whether to draw a branch without evidence. */
  #showDoubtStep(): void {
    this.previewing.forget();
    this.ui({ step: "airways", panel: "step" });
  }

  /** Answer the question about a branch without evidence: draw the branch by hand, or discard it. */
  answerDoubt(draw: boolean): void {
    const { doubt } = this.state;
    if (doubt === null) return;
    this.store.dispatch({ kind: "doubt_answered" });
    if (!draw) return;
    this.send({ type: "edit_tree", edit: { kind: "add-branch", lps: doubt.lps, even_without_evidence: true } });
  }

  /** Show the name of a branch as an editable field; null (no branch selected) shows a notice. */
  rename(branchId: number | null): void {
    if (branchId === null) this.notice("Choose a branch first: click it in the list or in a view.");
    else {
      this.disarm();
      this.ui({ renaming: branchId, step: "airways", panel: "step" });
    }
  }

  /** Return whether an action is possible now; the brush actions need an active brush. */
  #isAvailable(action: Action): boolean {
    return action !== "brush_smaller" && action !== "brush_larger" ? true : isBrush(this.state.ui.armed);
  }

  /** Open or close the panel of devices; the server sends device values only while it is open. */
  toggleDevices(): void {
    const devicesOpen = !this.state.ui.devicesOpen;
    this.ui({ devicesOpen, keysOpen: false });
    this.send({ type: "watch_devices", on: devicesOpen });
  }

  /** Show a view alone in its cell of the window. */
  show = (view: ViewName): void => this.ui({ shown: showing(view, this.state.ui.shown), sideBySide: false });

  #showNext(cell: CellName): void {
    this.show(nextIn(cell, this.state.ui.shown));
  }

  act = (action: Action): void => {
    if (this.state.watches && !WATCHERS_ACTIONS.has(action)) return;
    if (trainingLayout(this.state) !== undefined && !TRAINING_ACTIONS.has(action)) return;
    this.#actions[action]();
  };

  #wallPointAhead(): void {
    const viewport = this.wall.find(LEAD_VIEW);
    const header = viewport?.header ?? null;
    if (viewport == null || header === null || header.view !== LEAD_VIEW) return;
    if (this.state.ui.armed === null) this.pickWall(header, { column: header.width / 2, row: header.height / 2 });
    else this.pointing.click(viewport, viewport.middle);
  }

  /** Switch between the full frame and the last selected outline of the scope's picture. */
  #toggleOutline(): void {
    const outline = this.state.look.outline;
    if (outline !== "none") this.#outline = outline;
    this.send({ type: "set_outline", outline: outline === "none" ? this.#outline : "none" });
  }

  readonly #actions: Readonly<Record<Action, () => void>> = {
    auto_advance: () => this.#autoAdvance(),
    previous_fork: () => this.toFork("previous"),
    way_left: () => this.#chooseBranch(-1),
    way_right: () => this.#chooseBranch(1),
    toggle_mode: () => {
      this.flight.stopAuto();
      this.send({ type: "toggle_mode" });
    },
    join_pen: () => this.send({ type: "join_pen" }),
    pause_task: this.pauseTask,
    level_horizon: () => this.send({ type: "level_horizon" }),
    flip_operator: () =>
      this.send({ type: "set_operator", position: this.state.look.operator === "head" ? "facing" : "head" }),
    reset_look: () => this.send({ type: "reset_look" }),
    crosshair_to_tip: () => this.send({ type: "set_crosshair", lps: null }),
    swap_outside: () => this.#showNext("outside"),
    next_xray: () => this.#showNext("xray"),
    next_cut: () => this.#showNext("cut-plane"),
    toggle_tone: () => {
      if (this.state.session === null) return;
      const { carm } = this.state.sight;
      this.show(viewZoomedBy("carm"));
      const tone = carm.tone === "radiograph" ? "fluoroscopy" : "radiograph";
      this.sendSoon({ type: "set_carm", ...carm, tone });
    },
    next_slab: () => {
      const { slab } = this.state.sight;
      const at = SLABS.findIndex(
        (choice) =>
          choice.thickness_mm === slab.thickness_mm && (choice.thickness_mm === 0 || choice.kind === slab.kind),
      );
      this.sendSoon({ type: "set_slab", ...(SLABS[(at + 1) % SLABS.length] ?? SLABS[0]) });
    },
    toggle_shape: () => this.#toggleOutline(),
    full_screen: () => this.#toggleFullScreen(),
    toggle_outline: () => this.ui({ outlineVisible: !this.state.ui.outlineVisible }),
    save_video: () => this.films.open({ kind: "route" }),
    save_picture: () => this.pictures.saveFocused(),
    toggle_route_line: () => this.ui({ routeLineVisible: !this.state.ui.routeLineVisible }),
    arm_target: () => this.arm("target"),
    arm_root: () => this.arm("root"),
    tool_add: () => this.arm("add"),
    tool_bridge: () => this.arm("bridge"),
    tool_cut: () => this.arm("cut"),
    tool_fork: () => this.arm("fork"),
    tool_smooth: () => this.arm("smooth"),
    tool_paint: () => this.arm("paint"),
    tool_erase: () => this.arm("erase"),
    tool_reroot: () => this.arm("reroot"),
    rename: () => this.rename(shownBranch(this.state)),
    brush_smaller: () => this.ui({ brushMm: nextBrush(this.state.ui.brushMm, -1) }),
    brush_larger: () => this.ui({ brushMm: nextBrush(this.state.ui.brushMm, 1) }),
    find_branch: () => {
      const focus = () => document.querySelector<HTMLInputElement>(".branch-filter input")?.focus();
      this.ui({ list: "airways" });
      focus();
      // A list that was hidden appears with the next refresh of the display.
      requestAnimationFrame(focus);
    },
    window_airway: () => this.#setWindow("window_airway"),
    window_lung: () => this.#setWindow("window_lung"),
    window_mediastinum: () => this.#setWindow("window_mediastinum"),
    window_bone: () => this.#setWindow("window_bone"),
    undo: () => this.send({ type: "undo" }),
    redo: () => this.send({ type: "redo" }),
    lock_mouse: () => this.devices.lockMouse(),
    devices: () => this.toggleDevices(),
    add_key: () => this.addKey(),
    key_frames: () => this.#showKeys(!this.state.ui.keysOpen),
    save: () => this.save(),
    history: () => this.ui({ list: this.state.ui.list === "history" ? "airways" : "history", panel: "list" }),
    key_card: () => this.ui({ keyCardOpen: !this.state.ui.keyCardOpen }),
    wall_point: () => this.#wallPointAhead(),
    leave: () => {
      if (this.putToolAway() || this.#leaveGuide()) return;
      this.flight.stopAuto();
      this.pausePlaying();
      if (this.state.ui.full !== null) this.ui({ full: null });
      else this.store.dispatch({ kind: "picks", picks: [] });
    },
  };

  /** Show the airway view alone on the whole screen, or leave the whole screen. */
  #toggleFullScreen(): void {
    // The element is undefined in browsers without the whole screen.
    if ((document.fullscreenElement ?? null) !== null) {
      void document.exitFullscreen();
      return;
    }
    if (this.state.ui.full === LEAD_VIEW) {
      this.ui({ full: null });
      return;
    }
    this.ui({ full: LEAD_VIEW });
    const page: { requestFullscreen?: () => Promise<void> } = document.documentElement;
    // The whole page is requested, because dialogs and lists are beside the airway view in the page.
    const entered = page.requestFullscreen?.() ?? Promise.reject(new Error("no whole screen"));
    entered.catch(() => {
      this.notice("The browser does not allow the whole screen here. The airway view fills the window instead.");
    });
  }

  #setWindow(name: keyof typeof WINDOWS): void {
    if (this.state.session?.case?.is_hu === false) {
      this.notice(
        "Window presets are in HU, but this volume is not. Drag with the right mouse button in a slice instead.",
      );
    } else {
      this.send({ type: "set_window", ...WINDOWS[name] });
    }
  }

  #autoAdvance(): void {
    if (this.flight.isAuto || this.#autoWanted) {
      this.#autoWanted = false;
      this.flight.stopAuto();
      return;
    }
    const { route, session } = this.state;
    if (route === null) {
      this.notice("There is no route yet. Choose a branch in the list on the left, or mark a target.");
    } else if (session?.mode === "free") {
      // Start the automatic flight when the answer contains the position on the path.
      this.#autoWanted = this.send({ type: "set_mode", mode: "path" });
    } else if (!this.flight.startAuto()) {
      this.notice("This is the end of the route.");
    }
  }

  /** Show a warning, once per selected route, about the parts of the route that the CT does not show. */
  #warnOfDoubts(): void {
    const { route } = this.state;
    const words = route === null ? null : routeDoubts(route);
    if (words !== null && words !== this.#warnedOf) this.notice(words);
    this.#warnedOf = words;
  }

  #warnedOf: string | null = null;

  #chooseBranch(step: -1 | 1): void {
    const { tree, route, pose } = this.state;
    const at = pathMm(this.state);
    if (tree === null || route === null || pose === null || at === null) return;
    const turns = this.state.plans?.turns ?? [];
    const fork = forkAhead(tree, route, at, cameraFromMatrix(pose.lps_from_camera), null, turns);
    const way = fork === null ? null : neighbourBranch(fork.ways, step);
    if (fork === null) this.notice("There is no fork ahead on this route.");
    else if (way === null) this.notice(`There is no branch further ${step < 0 ? "left" : "right"}.`);
    else this.chooseBranch(mainLeaf(way.node).branch.id);
  }

  /**
   * Return whether the page needs every display refresh: something moves, is held, waits to be sent, or must be read.
   */
  #needsEveryRefresh(): boolean {
    const { playing, replaying } = this.state;
    const waits = this.#soon.size > 0 || this.#autoWanted;
    return waits || playing.on || replaying.on || this.flight.isMoving || this.devices.mustBeRead;
  }

  #tick(elapsedS: number): void {
    if (this.#autoWanted && this.state.pose?.path_mm != null) {
      this.#autoWanted = false;
      this.flight.startAuto();
    }
    this.flight.tick(elapsedS);
    this.player.tick(elapsedS);
    this.replayer.tick(elapsedS);
    this.devices.tick();
    if (this.#soon.size === 0) return;
    const messages = [...this.#soon.values()];
    this.#soon.clear();
    for (const message of messages) this.send(message);
  }

  // ------------------------------------------------------------------ places

  /** Return the tip's position on the route, mm, including a drag that is in progress; null in free movement. */
  pathMm(): number | null {
    return pathMm(this.state);
  }

  /** Return the point where the slices intersect, LPS mm: the crosshair, or the tip. */
  centre(): Vec3 | null {
    return crosshairLps(this.state) ?? tipLps(this.state);
  }

  #connectionChanged(status: StreamStatus): void {
    this.store.dispatch({ kind: "connection", connection: asConnection(status) });
    if (status.status !== "open") {
      this.flight.stopAuto();
      this.pausePlaying();
      this.#autoWanted = false;
      return;
    }
    this.#board.reset();
    this.#speed.reset();
    this.#pace.reset();
    this.pointing.reset();
    this.previewing.reset();
    if (this.state.ui.devicesOpen) this.#stream.send({ type: "watch_devices", on: true });
    if (this.state.ui.hiddenLayers.length > 0) this.#sendLayers();
    this.wall.sendLayout(true);
  }

  #showError(code: string, message: string, action: string | null): void {
    this.store.dispatch({ kind: "say", message: { kind: "error", code, message, action } });
  }
}
