/** The airway view with its toolbar above the picture and its text readings in the corners, outside the lumen. */

import {
  Button,
  Label,
  ListBox,
  ListBoxItem,
  Popover,
  Select,
  SelectValue,
  Slider,
  SliderOutput,
  SliderThumb,
  SliderTrack,
} from "react-aria-components";
import { keyOf } from "../input/keymap";
import type { OnwardBranch } from "../state/airways";
import { pathMm, scopeOf } from "../state/app-state";
import { kindText } from "../state/branch-text";
import { forkAhead } from "../state/fork";
import { fixed, mm, sentence } from "../state/format";
import { penOffText } from "../state/pen";
import { distanceToRouteMm, turnBefore } from "../state/plan";
import { nextStopMm, pastMm, placeText, sideText } from "../state/route";
import { arrowText, type TaskArrow, taskArrow } from "../state/task-arrow";
import { worksIn } from "../state/tools";
import { type Attempt, attemptOf, isAtQuestion, quizOf, trainingLayout } from "../state/training";
import { cameraFromMatrix, lookingUp } from "../state/vec";
import { wallPointLines } from "../state/wall-point";
import { wrongBranchText } from "../state/wrong-branch";
import { clipPathOf, shapeOf } from "../views/outline";
import type { HeldScope, QuizInfo, StateMessage } from "../wire/messages";
import { LEAD_VIEW } from "../wire/views";
import { Announcer } from "./Announcer";
import { BreathingLabel, BreathingMenu } from "./BreathingControls";
import { useApp, useStation } from "./context";
import { Act, Choice, SwitchKey, Tip, useKeysBack } from "./controls";
import { FlightPad } from "./FlightPad";
import { Icon } from "./icons";
import { PictureMenu } from "./PictureMenu";
import { PictureView } from "./PictureView";
import { PlanAnswer } from "./PlanAnswer";
import { ScopeSelect } from "./ScopeSelect";
import { ToolTag } from "./ToolTag";

/** Render the airway view with its toolbar and text readings. */
export function AirwayStage() {
  const outline = useApp((state) => state.look.outline);
  const shown = useApp((state) => state.frames[LEAD_VIEW] !== undefined);
  const armed = useApp((state) => state.ui.armed);
  const markable = armed === null ? undefined : worksIn(armed, LEAD_VIEW) ? "yes" : "no";
  const station = useStation();
  const attempt = useApp(attemptOf);
  const quiz = useApp(quizOf);
  return (
    <section className="airway-stage" aria-label="Airway view">
      <AirwayTools />
      <PlanAnswer />
      <div className="airway-picture" data-outline={outline} data-armed={markable}>
        <PictureView
          view={LEAD_VIEW}
          shape={shapeOf(outline)}
          name="Airway view, seen from the tip"
          onDoubleClick={() => station.ui({ full: station.state.ui.full === LEAD_VIEW ? null : LEAD_VIEW })}
        />
        {shown ? (
          <>
            <RedOut />
            {attempt !== null ? (
              <AttemptReadings attempt={attempt} />
            ) : quiz !== null ? (
              <QuizMark quiz={quiz} />
            ) : (
              <Readings />
            )}
            <FinderLabel />
            <EmptyLabel />
            <BreathingLabel />
          </>
        ) : (
          <p className="empty centre">The view from the scope tip appears here once the CT has loaded.</p>
        )}
        <ToolTag view={LEAD_VIEW} />
        <FlightPad />
      </div>
    </section>
  );
}

/** Render a red overlay on the airway picture while the lens touches the wall; the ring of letters stays uncovered. */
function RedOut() {
  const red = useApp((state) => state.pose?.scope?.red_out ?? 0);
  const shape = shapeOf(useApp((state) => state.look.outline));
  if (red <= 0) return null;
  const style = { opacity: red, clipPath: clipPathOf(shape) };
  return <div className="red-out" data-shape={shape} style={style} data-testid="red-out" aria-hidden="true" />;
}

/**
 * Render the state of the simulated scope (insertion, bend, roll, wall contacts), and the reason if it cannot move on.
 */
function ScopeReading() {
  const scope = useApp((state) => state.pose?.scope ?? null);
  const route = useApp((state) => state.route);
  if (scope === null) return null;
  const stop = scopeStop(scope);
  return (
    <>
      <span className="scope-reading" data-testid="scope-reading">
        <span>
          <span className="scope-word">inserted </span>
          <strong>{route === null ? mm(scope.insertion_mm, 0) : `to ${placeText(route, scope.insertion_mm)}`}</strong>
        </span>
        <span>
          bend <strong>{degrees(scope.flexion_rad)}</strong>, roll {degrees(scope.roll_rad)}
        </span>
      </span>
      {stop === null ? null : <span className="warning-text">{stop}</span>}
      {scope.num_contacts === 0 ? null : (
        <span className="quiet">
          wall contacts {scope.num_contacts} ({fixed(scope.contact_s, 1)} s)
        </span>
      )}
    </>
  );
}

const degrees = (rad: number): string => `${fixed((rad * 180) / Math.PI)}\u00b0`;

function scopeStop(scope: HeldScope): string | null {
  switch (scope.limit) {
    case "none":
      return scope.contact_mm === null ? null : "touching the wall";
    case "narrow":
      return scope.needs_mm === null
        ? "lumen too narrow"
        : `lumen too narrow: fits tips up to ${mm(scope.needs_mm)}${scope.tip_mm === null ? "" : `; this one is ${mm(scope.tip_mm)}`}`;
    case "wall":
      return "stopped by the wall";
    case "entry":
      return "fully withdrawn";
    case "length":
      return "fully inserted";
    case "flexion":
      return "lever at its limit";
  }
}

/** Render a label while a cut-plane (the viewfinder) replaces the airway view, because the view is too slow. */
function FinderLabel() {
  const isPlaceholder = useApp((state) => state.frames[LEAD_VIEW]?.stands_for === LEAD_VIEW);
  if (!isPlaceholder) return null;
  return (
    <p className="finder-label" role="status" data-testid="view-finder">
      <strong>Viewfinder: cut-plane at the tip</strong>
      <span>The airway view cannot keep up with this movement. Pause to let it catch up.</span>
    </p>
  );
}

/** Render a label while the airway picture is black, because the tip looks out of the CT. */
function EmptyLabel() {
  const station = useStation();
  const empty = useApp((state) => state.frames[LEAD_VIEW]?.empty ?? false);
  const alongPath = useApp((state) => state.pose?.mode === "path");
  if (!empty) return null;
  return (
    <div className="finder-label" role="status" data-testid="nothing-seen">
      <strong>Nothing to show: the tip is at the edge of the CT</strong>
      {alongPath ? (
        <Act
          kind="quiet"
          icon="straight"
          label="Look along the path"
          words="Look straight along the path"
          keys={keyOf("reset_look")}
          onPress={() => station.act("reset_look")}
        />
      ) : (
        <span>Withdraw, or choose a branch.</span>
      )}
    </div>
  );
}

function AirwayTools() {
  const station = useStation();
  const session = useApp((state) => state.session);
  const { outline, operator } = useApp((state) => state.look);
  const { shading, texture } = useApp((state) => state.sight);
  const hasRoute = useApp((state) => state.route !== null);
  const routeLineVisible = useApp((state) => state.ui.routeLineVisible);
  const watches = useApp((state) => state.watches);
  const trains = useApp((state) => trainingLayout(state) !== undefined);
  if (session === null) return null;
  const facing = operator === "facing";
  // Another mode of movement would end the attempt.
  const needs = trains ? "End the task or the quiz first" : "Needs a route: choose a branch or mark a target";
  return (
    <div className="tools" role="toolbar" aria-label="Airway view" inert={watches}>
      <Choice<StateMessage["mode"]>
        name="Movement"
        value={session.mode}
        choices={[
          {
            value: "path",
            label: "Path",
            words: hasRoute && !trains ? "Move along the route and look in any direction" : needs,
            keys: keyOf("toggle_mode"),
            disabled: !hasRoute || trains,
          },
          {
            value: "free",
            label: "Free",
            words: trains ? needs : "Move freely",
            keys: keyOf("toggle_mode"),
            disabled: trains,
          },
          {
            value: "scope",
            label: "Scope",
            words:
              hasRoute && !trains
                ? "A simulated bronchoscope: it bends, touches the wall and stops where the airway is too narrow"
                : needs,
            disabled: !hasRoute || trains,
          },
        ]}
        onChange={(mode) => station.send({ type: "set_mode", mode })}
      />
      <Act
        kind="icon"
        icon="operator"
        short={facing ? "Facing" : "Head end"}
        words={
          facing
            ? "The operator is facing the patient. Click to stand at the head end."
            : "The operator is at the head end. Click to face the patient."
        }
        keys={keyOf("flip_operator")}
        onPress={() => station.act("flip_operator")}
      />
      <Act
        kind="icon"
        icon="level"
        short="Level"
        words="Level the horizon"
        keys={keyOf("level_horizon")}
        onPress={() => station.act("level_horizon")}
      />
      <Act
        kind="icon"
        icon="straight"
        short="Straight"
        words="Look straight along the path"
        keys={keyOf("reset_look")}
        onPress={() => station.act("reset_look")}
      />
      <span className="space" />
      <ScopeSelect />
      <TransferSelect />
      <Fov />
      <SwitchKey
        icon="light"
        short="Light"
        words={shading ? "Light at the tip: on" : "Light at the tip: off"}
        on={shading}
        onChange={() => station.send({ type: "set_shading", on: !shading })}
      />
      {session.transfer_document?.appearance != null && (
        <SwitchKey
          icon="texture"
          short="Decoration"
          words={
            texture
              ? "Decoration: on. Rings, vessels and the fine texture of the wall are drawn, not from the CT."
              : "Decoration: off. The wall shows only what is in the CT."
          }
          on={texture}
          testId="texture"
          onChange={() => station.send({ type: "set_texture", on: !texture })}
        />
      )}
      <BreathingMenu />
      <SwitchKey
        icon="routeLine"
        short="Route line"
        words="Route line"
        keys={keyOf("toggle_route_line")}
        on={routeLineVisible}
        onChange={() => station.act("toggle_route_line")}
      />
      <SwitchKey
        icon="round"
        short={outline === "octagon" ? "Octagon" : "Round"}
        words={outline === "octagon" ? "Octagon: the image of this scope" : "Round image, as through a bronchoscope"}
        keys={keyOf("toggle_shape")}
        on={outline !== "none"}
        onChange={() => station.act("toggle_shape")}
      />
      <Act
        kind="icon"
        icon="screen"
        words="Airway view alone on the whole screen, and back"
        keys={keyOf("full_screen")}
        testId="full-screen"
        onPress={() => station.act("full_screen")}
      />
      <PictureMenu view={LEAD_VIEW} />
    </div>
  );
}

const TRANSFER_TEXTS: Readonly<Record<string, string>> = {
  endoscopic: "Endoscopic",
  paper: "Opaque tissue",
  "ct-grey": "CT greyscale",
  "see-through": "See-through",
  "from histogram": "Histogram",
};

const transferText = (name: string): string => TRANSFER_TEXTS[name] ?? name;

function TransferSelect() {
  const station = useStation();
  const keysBack = useKeysBack();
  const presets = useApp((state) => state.session?.transfer_presets ?? null);
  const transfer = useApp((state) => state.session?.transfer ?? "");
  const names =
    presets === null ? [] : presets.includes(transfer) || transfer === "" ? presets : [transfer, ...presets];
  return (
    <Select
      aria-label="Wall style"
      className="select"
      onOpenChange={keysBack.onOpenChange}
      selectedKey={transfer}
      onSelectionChange={(key) => {
        if (key !== null && key !== transfer)
          station.send({ type: "set_transfer", preset: String(key), document: null });
      }}
    >
      <Tip words="Wall colours in the airway view">
        <Button className="button" onPressStart={keysBack.onPressStart}>
          <SelectValue>{() => transferText(transfer)}</SelectValue>
          <Icon name="down" />
        </Button>
      </Tip>
      <Popover className="popover" offset={4}>
        <ListBox className="listbox">
          {names.map((name) => (
            <ListBoxItem key={name} id={name} textValue={transferText(name)} className="listbox-item">
              {transferText(name)}
            </ListBoxItem>
          ))}
        </ListBox>
      </Popover>
    </Select>
  );
}

function Fov() {
  const station = useStation();
  const fov = useApp((state) => state.look.fov_deg);
  return (
    <Slider
      className="slider inline"
      minValue={60}
      maxValue={170}
      step={5}
      value={Math.min(Math.max(fov, 60), 170)}
      onChange={(value) => station.sendSoon({ type: "set_fov", fov_deg: value })}
    >
      <Label className="visually-hidden">Field of view</Label>
      <Tip words="Field of view: the full angle across the image">
        <Button className="plain-text" excludeFromTabOrder>
          <SliderOutput className="numbers">{() => `${fixed(fov)}\u00b0`}</SliderOutput>
        </Button>
      </Tip>
      <SliderTrack className="slider-track">
        <SliderThumb className="slider-thumb" />
      </SliderTrack>
    </Slider>
  );
}

/** Render the measured speed of the tip, whatever device moves it; nothing at rest. */
function SpeedReading() {
  const speed = useApp((state) => state.speedMmS);
  if (speed === null) return null;
  return (
    <span data-testid="speed">
      speed{" "}
      <strong>
        {fixed(speed, Number.isInteger(speed) ? 0 : 1)}
        {"\u202f"}mm/s
      </strong>
    </span>
  );
}

/** Render the offset between the tip and the tracked pen that it follows; nothing once the tip is at the pen. */
function PenReading() {
  const words = useApp((state) => penOffText(state.pen));
  if (words === null) return null;
  return (
    <span className="warning-text" data-testid="pen-offset">
      pen <strong>{words}</strong> away <kbd>{keyOf("join_pen")}</kbd>
    </span>
  );
}

/** Render position, airway, distance and voxel value of the last clicked wall point. */
function WallReading() {
  const picks = useApp((state) => state.picks);
  const tree = useApp((state) => state.tree);
  const isHu = useApp((state) => state.session?.case?.is_hu ?? true);
  const latest = picks.at(-1);
  if (latest === undefined) return null;
  const label = latest.branchId === null ? null : (tree?.byId.get(latest.branchId)?.label ?? null);
  return (
    <div className="wall-reading" role="status" data-testid="wall-point">
      <strong>wall point</strong>
      {wallPointLines(picks, label, isHu).map((words) => (
        <span key={words}>{words}</span>
      ))}
    </div>
  );
}

/** Distance, mm, from the end of the route below which the tip counts as being at the end. */
const AT_END_MM = 0.1;

const directionText = ({ hour, noHour }: OnwardBranch): string =>
  hour === null ? (noHour ?? "straight ahead") : `${hour} o\u2019clock`;

/** Render the mark on the opening that a quiz asks for, while the tip looks at it from the place of the question. */
function QuizMark({ quiz }: { quiz: QuizInfo }) {
  const shown = useApp((state) => quiz.kind === "name-opening" && isAtQuestion(state, quiz));
  return shown ? <div className="quiz-mark" data-testid="quiz-mark" aria-hidden="true" /> : null;
}

/** Render the state of the scope and the latest event of a running attempt; names only where the task shows them. */
function AttemptReadings({ attempt }: { attempt: Attempt }) {
  const name = useApp((state) => state.pose?.branch_name ?? null);
  const { message, is_warning: isWarning, paused } = attempt.running;
  const arrow = useTaskArrow(attempt);
  return (
    <>
      {arrow === null || paused ? null : <ArrowMark arrow={arrow} />}
      {paused ? (
        <p className="attempt-paused" role="status" data-testid="attempt-paused">
          Paused. Press {keyOf("pause_task")} or Continue to fly on.
        </p>
      ) : null}
      <div className="reading top-left" data-testid="hud">
        {attempt.task.names_shown && name !== null ? <strong>{name}</strong> : null}
      </div>
      <div className="reading top-right numbers">
        <ScopeReading />
      </div>
      <div className="reading bottom-left">
        {arrow === null ? null : <strong data-testid="arrow-text">{arrowText(arrow)}</strong>}
        <span role="status" className={isWarning ? "warning-text" : undefined} data-testid="attempt-message">
          {message === null ? "" : sentence(message)}
        </span>
      </div>
    </>
  );
}

/** Return the direction of the next turn of a task with the hint `arrow`; null for other tasks. */
function useTaskArrow({ running }: Attempt): TaskArrow | null {
  const pose = useApp((state) => state.pose);
  const tree = useApp((state) => state.tree);
  const viewUpDeg = useApp((state) => scopeOf(state)?.view_up_deg ?? 0);
  if (pose === null) return null;
  return taskArrow(tree, pose, lookingUp(cameraFromMatrix(pose.lps_from_camera), viewUpDeg), running.arrow_branches);
}

/** Render the arrow to the next turn: at the clock hour of its opening, up for straight ahead, down to withdraw. */
function ArrowMark({ arrow }: { arrow: TaskArrow }) {
  const turned = arrow.kind === "turn" ? `rotate(${30 * arrow.hour} 50 50)` : undefined;
  return (
    <svg
      className="arrow-mark"
      viewBox="0 0 100 100"
      data-kind={arrow.kind}
      data-testid="arrow-mark"
      aria-hidden="true"
    >
      {arrow.kind === "turn" ? (
        <path d="M50 4 L60 22 H54 V34 H46 V22 H40 Z" transform={turned} />
      ) : arrow.kind === "back" ? (
        <path d="M50 96 L60 78 H54 V66 H46 V78 H40 Z" />
      ) : (
        <circle cx="50" cy="50" r="7" />
      )}
    </svg>
  );
}

/** Render the tip's branch, its position on the route and the fork ahead as text in the corners of the airway view. */
function Readings() {
  const watches = useApp((state) => state.watches);
  const pose = useApp((state) => state.pose);
  const tree = useApp((state) => state.tree);
  const route = useApp((state) => state.route);
  const at = useApp(pathMm);
  const station = useStation();
  const advancing = useApp((state) => state.ui.advancing);
  const viewUpDeg = useApp((state) => scopeOf(state)?.view_up_deg ?? 0);
  const turns = useApp((state) => state.plans?.turns ?? null);
  if (pose === null) return null;
  const camera = cameraFromMatrix(pose.lps_from_camera);
  // At the viewpoint of a listed turn, the fork ahead is the fork of that turn, although the tip is not on the path.
  const turn = turnBefore(turns ?? [], camera.position);
  const forkBranchId = turn === null ? null : (turns?.[turn]?.fork_branch_id ?? null);
  const forkFrom =
    pose.mode === "path" || route === null || forkBranchId === null ? at : distanceToRouteMm(route, camera.position);
  const fork =
    tree === null || route === null || forkFrom === null || (pose.mode !== "path" && forkBranchId === null)
      ? null
      : forkAhead(tree, route, forkFrom, lookingUp(camera, viewUpDeg), forkBranchId, turns ?? []);
  const toFork = route !== null && at !== null && nextStopMm(route, at) < route.length_mm;
  const atEnd = route !== null && at !== null && pose.mode === "path" && at > route.length_mm - AT_END_MM;
  const node = pose.branch_id === null ? undefined : tree?.byId.get(pose.branch_id);
  const kind = node === undefined ? null : kindText(node.branch.kind);
  const wrong = wrongBranchText(pose, tree);
  return (
    <>
      <Announcer way={{ fork, atEnd, wrong }} />
      {wrong === null ? null : (
        <p className="finder-label" data-testid="wrong-branch">
          <strong>
            Wrong branch: you are in {wrong.branch}; back {wrong.back}
          </strong>
        </p>
      )}
      <div className="reading top-left" data-testid="hud">
        {pose.inside ? (
          <strong>{pose.branch_name ?? node?.label ?? (tree === null ? "In the volume" : "Airway")}</strong>
        ) : (
          // In scope mode the tip cannot leave the lumen. A tip that touches the wall may be in a voxel outside the
          // lumen.
          <strong className="warning-text">{pose.scope === null ? "Outside the airway" : "Touching the wall"}</strong>
        )}
        {pose.generation === null ? null : <span>generation {pose.generation}</span>}
        {kind === null ? null : <span className="warning-text">{kind}: the CT shows no airway here</span>}
      </div>
      <div className="reading top-right numbers">
        {at === null ? null : (
          <span>
            {route === null ? "depth" : sideText(route, at)}{" "}
            <strong>{mm(route === null ? at : Math.abs(pastMm(route, at)), 0)}</strong>
          </span>
        )}
        <ScopeReading />
        <PenReading />
        <SpeedReading />
        {pose.lumen_mm === null ? null : (
          <span>
            lumen <strong>{mm(pose.lumen_mm)}</strong>
          </span>
        )}
        <WallReading />
      </div>
      <div className="reading bottom-left numbers">
        {atEnd ? <span>end of the route</span> : null}
        {fork === null || atEnd ? null : (
          <>
            <span>{fork.distanceMm <= 0 ? "at the fork" : `fork in ${mm(fork.distanceMm, 0)}`}</span>
            <span className="ways">
              {fork.ways.map((way) => (
                <span key={way.node.branch.id} className={way.chosen ? "way chosen" : "way"}>
                  {fork.near ? `${way.node.label}, ${directionText(way)}` : way.node.label}
                </span>
              ))}
            </span>
          </>
        )}
      </div>
      <div className="reading bottom-right">
        {atEnd || watches ? null : pose.mode === "path" && route !== null ? (
          <Act
            kind="quiet"
            icon={advancing ? "stop" : "play"}
            testId="fly-on"
            label={advancing ? "Stop" : toFork ? "Fly to next fork" : "Fly to the end"}
            words={
              advancing
                ? "Stop here"
                : toFork
                  ? "Advance to the next fork and stop in front of it"
                  : "Advance to the end of the route"
            }
            keys={keyOf("auto_advance")}
            onPress={() => station.act("auto_advance")}
          />
        ) : pose.mode === "free" ? (
          <span className="quiet">free movement</span>
        ) : null}
      </div>
    </>
  );
}
