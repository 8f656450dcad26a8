/**
 * Planned routes of a target: their comparison, the verdicts of instruments on the selected route, and the printable
 * plan.
 */

import { useState } from "react";
import { Button } from "react-aria-components";
import { tipLps } from "../../state/app-state";
import { caseFacts } from "../../state/case-list";
import { sentence } from "../../state/format";
import { othersText, ROUTE_ROWS, turnBefore, turnText, verdictsInOrder } from "../../state/plan";
import type { PlansMessage, RecentCase, ScopeVerdict, Target, TargetPlan } from "../../wire/messages";
import { useApp, useStation } from "../context";
import { Act } from "../controls";
import type { PlanSuffix } from "../file-transfers";
import { Icon } from "../icons";
import { PanelAnswer, useIsAnswered } from "../PlanAnswer";
import { Pickers } from "../StartPage";
import { CArmAngles } from "./CArmAngles";
import { OUTCOME_MARKS } from "./outcome-marks";
import { ReasonsAgainst } from "./ReasonsAgainst";
import { RouteLymphNodeStations } from "./RouteLymphNodeStations";
import { RoutePairs } from "./RoutePairs";
import { SendToPacs } from "./SendToPacs";

/** Render the planned routes of a target, with verdicts and exports. */
export function PlannedRoutes({ target, plan }: { target: Target; plan: TargetPlan }) {
  const plans = useApp((state) => state.plans);
  const chosen = plan.chosen === null ? null : (plan.routes[plan.chosen - 1] ?? null);
  const answered = useIsAnswered(plan);
  return (
    <div className="planned" data-testid="planned">
      <p>
        To <strong>{target.name}</strong>
      </p>
      {plan.routes.length === 0 ? null : <PanelAnswer plan={plan} />}
      {answered ? null : <ReasonsAgainst reasons={plan.reasons} />}
      {plan.problem === null || answered || plan.reasons.length > 0 ? null : (
        <p className="warning-text">
          <Icon name="warning" /> {sentence(plan.problem)}
        </p>
      )}
      {chosen === null || answered ? null : <PrintButton target={target} />}
      {plan.routes.length === 0 ? null : <RouteTable target={target} plan={plan} />}
      {chosen === null ? null : (
        <p className="quiet">
          Along the needle’s line:{" "}
          {chosen.leg.crossed
            .filter((one) => one.tissue !== "lumen")
            .map((one) => `${one.tissue} ${(one.to_mm - one.from_mm).toFixed(0)}\u202fmm`)
            .join(", ")}
          .
        </p>
      )}
      {plan.movement === null ? null : (
        <p className="quiet" data-testid="movement">
          {sentence(plan.movement)}.
        </p>
      )}
      <SecondCt target={target} plan={plan} />
      {chosen === null || plans === null ? null : (
        <>
          <RoutePairs target={target} plan={plan} plans={plans} />
          <Verdicts plans={plans} planned={plan.options.scope} />
          <Turns plans={plans} />
          <CArmAngles plans={plans} />
          <RouteLymphNodeStations plan={plan} note={plans.station_note} />
          <Exports target={target} />
        </>
      )}
      <Options target={target} plan={plan} />
    </div>
  );
}

function RouteTable({ target, plan }: { target: Target; plan: TargetPlan }) {
  const station = useStation();
  return (
    <div className="routes-scroll">
      <table className="routes numbers">
        <thead>
          <tr>
            <th scope="col">Route</th>
            {plan.routes.map((route, index) => (
              <th scope="col" key={route.key}>
                <Act
                  kind={plan.chosen === index + 1 ? "primary" : "plain"}
                  label={`${index + 1}`}
                  words={plan.chosen === index + 1 ? "This route is taken" : `Take route ${index + 1}`}
                  testId={`route-${index + 1}`}
                  onPress={() => station.takePlannedRoute(target.target_id, index + 1)}
                />
              </th>
            ))}
          </tr>
        </thead>
        <tbody>
          {ROUTE_ROWS.map(({ title, words, of }) => (
            <tr key={title}>
              <th scope="row" title={words}>
                {title}
              </th>
              {plan.routes.map((route, index) => (
                <td key={route.key} className={plan.chosen === index + 1 ? "chosen" : undefined}>
                  {of(route)}
                  {title === "Airway" && route.doubts.length > 0 ? (
                    <span className="error-text" title={route.doubts.map(sentence).join(". ")}>
                      {" "}
                      <Icon name="warning" />
                    </span>
                  ) : null}
                </td>
              ))}
            </tr>
          ))}
        </tbody>
      </table>
      <PredictorNote plan={plan} />
    </div>
  );
}

function PredictorNote({ plan }: { plan: TargetPlan }) {
  const note = plan.routes.find((route) => route.predictors)?.predictors?.note;
  return note ? (
    <p className="quiet" data-testid="predictor-note">
      * {note}
    </p>
  ) : null;
}

function Options({ target, plan }: { target: Target; plan: TargetPlan }) {
  const station = useStation();
  const tools = useApp((state) => state.plans?.tools ?? null);
  const scopes = useApp((state) => state.start?.scopes ?? null);
  const change = (changed: Partial<TargetPlan["options"]>) =>
    station.send({ type: "set_plan_options", target_id: target.target_id, ...plan.options, ...changed });
  return (
    <details className="plan-options">
      <summary>Instruments and margins</summary>
      <label>
        Bronchoscope, also of the airway view
        <select
          value={plan.options.scope}
          data-testid="plan-scope"
          onChange={(event) => station.send({ type: "set_scope", scope: event.target.value })}
        >
          {(scopes ?? []).map((scope) => (
            <option key={scope.name} value={scope.name}>
              {scope.title}
            </option>
          ))}
        </select>
      </label>
      <label>
        Tool
        <select value={plan.options.tool} onChange={(event) => change({ tool: event.target.value, place: null })}>
          {(tools ?? []).map(([name, title]) => (
            <option key={name} value={name}>
              {title}
            </option>
          ))}
        </select>
      </label>
      <Millimetres
        title="Vessel margin, mm"
        value={plan.options.vessel_margin_mm}
        most={50}
        onChange={(value) => change({ vessel_margin_mm: value ?? 3 })}
      />
      <Millimetres
        title="Target may have moved, mm"
        value={plan.options.moved_mm}
        most={60}
        placeholder={movedPlaceholder(plan)}
        onChange={(value) => change({ moved_mm: value, movement: null })}
      />
      <Millimetres
        title="Depth of the main carina at nose or mouth, mm"
        value={plan.options.carina_depth_mm}
        most={600}
        placeholder={
          plan.options.entry_mm === null
            ? "not given"
            : `start of the tree at ${plan.options.entry_mm.toFixed(0)}\u202fmm (earlier version)`
        }
        onChange={(value) => change({ carina_depth_mm: value, entry_mm: null })}
      />
    </details>
  );
}

const NO_CASES: readonly RecentCase[] = [];

function movedPlaceholder(plan: TargetPlan): string {
  if (plan.options.movement !== null) return "measured from the second CT";
  return plan.moved_mm === null ? "by lobe" : `by lobe: ${plan.moved_mm.toFixed(0)}`;
}

/** Render the field for a second CT of the patient, from which the movement of the target is measured. */
function SecondCt({ target, plan }: { target: Target; plan: TargetPlan }) {
  const station = useStation();
  const [path, setPath] = useState("");
  const [recentId, setRecentId] = useState("");
  const all = useApp((state) => state.start?.recent ?? NO_CASES);
  const begun = useApp((state) => state.session?.saving.begun_s ?? null);
  // The CT of the plan itself cannot show a movement.
  const recent = all.filter((one) => one.opens && (begun === null || one.begun_s !== begun));
  // A case that is no longer listed cannot be measured from.
  const chosen = recent.some((one) => one.recent_id === recentId) ? recentId : "";
  const measure = () => {
    const target_id = target.target_id;
    if (path.trim() !== "") station.send({ type: "measure_movement", target_id, path: path.trim() });
    else if (chosen !== "") station.send({ type: "measure_movement_from_case", target_id, recent_id: chosen });
  };
  return (
    <details className="plan-options" data-testid="second-ct-options">
      <summary>Measure the movement from a second CT</summary>
      <p className="quiet">Choose a second CT of this patient: in expiration, or an earlier one.</p>
      <Pickers onFiles={(files) => void station.transfers.upload(files, "movement", { targetId: target.target_id })} />
      {recent.length === 0 ? null : (
        <label>
          or a recent case
          <select
            value={chosen}
            data-testid="second-ct-recent"
            onChange={(event) => {
              setRecentId(event.target.value);
              setPath("");
            }}
          >
            <option value="">{"Choose a case\u2026"}</option>
            {recent.map((one) => (
              <option key={one.recent_id} value={one.recent_id}>
                {[one.title, ...caseFacts(one, recent, Date.now())].join(" \u00b7 ")}
              </option>
            ))}
          </select>
        </label>
      )}
      <label>
        or type the path of a folder, file or case on this machine
        <input
          type="text"
          value={path}
          placeholder="/data/ct/series"
          data-testid="second-ct"
          onChange={(event) => {
            setPath(event.target.value);
            setRecentId("");
          }}
          onKeyDown={(event) => {
            event.stopPropagation();
            if (event.key === "Enter") measure();
          }}
        />
      </label>
      <div className="row">
        <Act
          label="Measure"
          words="Compare forks and vessels with the second CT, and plan with the target's shift (about a minute)"
          disabled={path.trim() === "" && chosen === ""}
          testId="measure-movement"
          onPress={measure}
        />
        {plan.options.movement === null ? null : (
          <Act
            kind="quiet"
            label="Use the default"
            words="Discard the measured movement and plan with the default of the target's lobe"
            testId="forget-movement"
            onPress={() =>
              station.send({
                type: "set_plan_options",
                target_id: target.target_id,
                ...plan.options,
                movement: null,
              })
            }
          />
        )}
      </div>
    </details>
  );
}

/** Render a field for an optional length in mm, which is saved when the field loses focus or on Enter. */
function Millimetres({
  title,
  value,
  most,
  placeholder,
  onChange,
}: {
  title: string;
  value: number | null;
  most: number;
  placeholder?: string;
  onChange: (value: number | null) => void;
}) {
  const [text, setText] = useState<string | null>(null);
  const keep = () => {
    if (text === null) return;
    const number = text.trim() === "" ? null : Number(text.replace(",", "."));
    setText(null);
    if (number === null || (Number.isFinite(number) && number >= 0 && number <= most)) {
      if (number !== value) onChange(number);
    }
  };
  return (
    <label>
      {title}
      <input
        type="text"
        inputMode="decimal"
        value={text ?? (value === null ? "" : String(value))}
        placeholder={placeholder}
        onChange={(event) => setText(event.target.value)}
        onBlur={keep}
        onKeyDown={(event) => {
          event.stopPropagation();
          if (event.key === "Enter") event.currentTarget.blur();
        }}
      />
    </label>
  );
}

function Verdicts({ plans, planned }: { plans: PlansMessage; planned: string }) {
  const [all, setAll] = useState(false);
  const own = plans.verdicts.find((verdict) => verdict.scope === planned) ?? null;
  const others = verdictsInOrder(plans.verdicts).filter((verdict) => verdict !== own);
  return (
    <div className="verdicts" data-testid="verdicts">
      <h3>Instruments</h3>
      {own === null ? (
        <p className="quiet">
          {plans.verdicts_standing === "making" ? "Simulating the drive\u2026" : "No verdict yet."}
        </p>
      ) : (
        <VerdictRow verdict={own} />
      )}
      {others.length === 0 ? null : (
        <>
          <Act
            kind="quiet"
            label={all ? "Hide the other instruments" : othersText(others, plans.verdicts_standing)}
            words="What the other instruments of the library can do on this route"
            testId="all-verdicts"
            onPress={() => setAll(!all)}
          />
          {all ? others.map((verdict) => <VerdictRow key={verdict.scope} verdict={verdict} />) : null}
        </>
      )}
      {plans.verdicts_standing === "making" && own !== null ? (
        <p className="quiet">{"The other instruments follow\u2026"}</p>
      ) : null}
    </div>
  );
}

function VerdictRow({ verdict }: { verdict: ScopeVerdict }) {
  const station = useStation();
  return (
    <details className={`verdict ${verdict.outcome.replaceAll(" ", "-")}`} data-testid="verdict">
      <summary>
        <span className="mark" aria-hidden="true">
          {OUTCOME_MARKS[verdict.outcome] ?? "?"}
        </span>
        <span>
          <strong>{verdict.title}</strong>
          <br />
          {sentence(verdict.words)}
        </span>
      </summary>
      <ul>
        {verdict.checks.map((check) => (
          <li key={check.name} className={check.answer}>
            <span title={check.basis}>{sentence(check.words)}</span>
          </li>
        ))}
      </ul>
      {verdict.would === null ? null : <p className="quiet">{sentence(verdict.would)}</p>}
      {verdict.was_driven ? (
        <Act
          kind="quiet"
          label="Keep the drive as a flight"
          words="Add the camera view of this simulated drive to the recorded flights of the case"
          testId={`keep-drive-${verdict.scope}`}
          onPress={() => station.send({ type: "keep_drive", scope: verdict.scope })}
        />
      ) : null}
    </details>
  );
}

const PLAN_FILES: readonly [PlanSuffix, string, string][] = [
  [".pdf", "PDF", "Save the report as a PDF"],
  [".json", "JSON", "Save the plan as JSON, for other programs"],
  [".mrk.json", "Slicer", "Targets, routes and needles for 3D Slicer"],
  [".seg.nrrd", "Segmentation", "The target as a segmentation for 3D Slicer"],
];

/**
 * Render the list of turns of the selected route. A click moves the tip to the viewpoint of the fork, from which the
 * view shows the listed clock hour.
 */
function Turns({ plans }: { plans: PlansMessage }) {
  const station = useStation();
  const operator = useApp((state) => state.look.operator);
  const at = useApp((state) => turnBefore(state.plans?.turns ?? [], tipLps(state)));
  const turns = plans.turns ?? [];
  if (turns.length === 0) return null;
  const stop = plans.parking?.[operator === "head" ? 0 : 1] ?? null;
  return (
    <details className="turns" data-testid="turns" open>
      <summary>Turns, for an operator {operator === "head" ? "at the head" : "who faces the patient"}</summary>
      <ol>
        {turns.map((turn, index) => (
          <li key={`${turn.fork_branch_id} ${turn.head}`} className={at === index ? "chosen" : undefined}>
            <Button
              className="turn"
              data-testid={`turn-${index + 1}`}
              isDisabled={turn.seen_from_lps === null}
              onPress={() => {
                station.flight.stopAuto();
                station.send({ type: "see_turn", number: index + 1 });
              }}
            >
              {turnText(turn, operator)}
            </Button>
          </li>
        ))}
        {stop === null ? null : <li className="quiet">{stop}</li>}
      </ol>
    </details>
  );
}

/** Render the button that prints the plan. */
function PrintButton({ target }: { target: Target }) {
  const station = useStation();
  return (
    <Act
      kind="primary"
      icon="file"
      label="Print the plan"
      words="Make the report, and open it in a new tab to be printed"
      testId="print-plan"
      onPress={() => station.transfers.printPlan(target.target_id, "report")}
    />
  );
}

/** Render the exports of the plan. */
function Exports({ target }: { target: Target }) {
  const station = useStation();
  const making = useApp((state) => state.ui.making);
  return (
    <>
      <div className="row">
        <Act
          kind="quiet"
          label="Tracing sheet"
          words="One page for the theatre: every turn with its clock hour"
          onPress={() => station.transfers.printPlan(target.target_id, "tracing")}
        />
        {PLAN_FILES.map(([suffix, label, words]) => (
          <Act
            key={suffix}
            kind="quiet"
            label={making === `plan${suffix}` ? "Preparing\u2026" : label}
            words={words}
            disabled={making !== null}
            testId={`take-plan${suffix}`}
            onPress={() => void station.transfers.takePlan(target.target_id, suffix)}
          />
        ))}
      </div>
      <Archive target={target} />
    </>
  );
}

const ARCHIVE_FILES: readonly [PlanSuffix, string, string][] = [
  [".seg.dcm", "SEG", "The target as a DICOM segmentation of this CT"],
  [".sr.dcm", "SR", "Its measurements as a DICOM structured report"],
  [".pdf.dcm", "PDF", "The report as a PDF in a DICOM file"],
];

/**
 * Render the export of the plan to DICOM, which refers to the images of the CT. If their folder is unknown, the text
 * states what is missing.
 */
function Archive({ target }: { target: Target }) {
  const station = useStation();
  const problem = useApp((state) => state.plans?.dicom_problem ?? null);
  const making = useApp((state) => state.ui.making);
  const [named, setNamed] = useState(false);
  // The saved connections are requested only when they are shown.
  const [isOpen, setOpen] = useState(false);
  return (
    <details className="plan-options" data-testid="archive" onToggle={(event) => setOpen(event.currentTarget.open)}>
      <summary>DICOM for the archive</summary>
      {problem === null ? (
        <>
          <label className="check">
            <input type="checkbox" checked={named} onChange={(event) => setNamed(event.target.checked)} />
            With the name and number of the CT's patient
          </label>
          <div className="row">
            {ARCHIVE_FILES.map(([suffix, label, words]) => (
              <Act
                key={suffix}
                kind="quiet"
                label={making === `plan${suffix}` ? "Preparing\u2026" : label}
                words={words}
                disabled={making !== null}
                testId={`take-plan${suffix}`}
                onPress={() => void station.transfers.takePlan(target.target_id, suffix, named)}
              />
            ))}
          </div>
          <p className="quiet">
            {named ? "The files name the patient." : "The files name nobody, but keep the CT's identifiers (UIDs)."}
          </p>
          {isOpen ? <SendToPacs targetId={target.target_id} /> : null}
        </>
      ) : (
        <p className="quiet" data-testid="archive-problem">
          {sentence(problem)}
        </p>
      )}
    </details>
  );
}
