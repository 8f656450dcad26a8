/**
 * Card of a target with a size: its kind, its dimensions, the user's description, and the needle path to the target.
 */

import { useId, useState } from "react";
import { Input, Label, TextArea, TextField } from "react-aria-components";
import { sentence } from "../../state/format";
import { planOf } from "../../state/plan";
import { asVec3 } from "../../state/vec";
import type { Target, TargetPlan } from "../../wire/messages";
import { useApp, useStation } from "../context";
import { Act, Choice, SwitchKey } from "../controls";
import { Icon } from "../icons";
import { PanelAnswer } from "../PlanAnswer";
import { TargetDoubts } from "./TargetDoubts";

/** Render the card of a target with a size. */
export function LesionCard({ target }: { target: Target }) {
  const station = useStation();
  const plan = useApp((state) => planOf(state.plans, target.target_id));
  const standing = useApp((state) => state.plans?.standing ?? "unwanted");
  const found = useApp((state) => state.session?.airways === "found");
  const [editing, setEditing] = useState(false);
  const first = plan?.routes[0] ?? null;
  return (
    <li className={plan?.chosen == null ? "target" : "target chosen"} data-testid="lesion">
      <span className="diamond lesion">
        <Icon name="target" />
      </span>
      <div>
        {editing ? (
          <Describe target={target} onDone={() => setEditing(false)} />
        ) : (
          <span className="lesion-title">
            <strong>{target.name}</strong>
            <Act
              kind="icon"
              icon="pencil"
              words={`Name, priority and notes of ${target.name}`}
              testId="describe-target"
              onPress={() => setEditing(true)}
            />
          </span>
        )}
        {plan === null ? null : (
          <span className="quiet numbers" data-testid="lesion-size">
            {sentence(plan.size)}
            {plan.where === null ? "" : `, ${plan.where}`}
          </span>
        )}
        {target.note === "" || editing ? null : <span className="quiet lesion-note">{target.note}</span>}
        {plan?.bronchus_sign == null ? null : <span className="quiet">Bronchus sign: {plan.bronchus_sign}</span>}
        {plan === null ? null : <TargetDoubts target={target} plan={plan} />}
        {plan === null || first === null || plan.unconfirmed.length > 0 ? null : <PanelAnswer plan={plan} />}
        {plan !== null && plan.unconfirmed.length > 0 ? null : plan !== null && plan.problem !== null ? (
          <span className="warning-text" data-testid="lesion-problem">
            <Icon name="warning" /> {sentence(plan.problem)}
          </span>
        ) : standing === "making" ? (
          <span className="quiet">{"Planning the routes\u2026"}</span>
        ) : found ? null : (
          <span className="quiet">The routes are planned once the airways have been segmented.</span>
        )}
        {first === null || plan === null ? null : (
          <Act
            kind={plan.chosen === null ? "primary" : "plain"}
            icon="play"
            label={plan.chosen === null ? "Take the best route" : `Route ${plan.chosen} is taken`}
            words={
              plan.chosen === null ? `Via ${first.branch_name}; the other routes are under Route` : "Compare the routes"
            }
            testId="take-route"
            onPress={() => {
              if (plan.chosen === null) station.takePlannedRoute(target.target_id, 1);
              else station.toStep("route");
            }}
          />
        )}
        {editing && plan !== null ? <Boundary target={target} plan={plan} /> : null}
        <span className="row">
          <Act
            kind="quiet"
            label="Show"
            words="Move the crosshair to this target"
            onPress={() => station.send({ type: "set_crosshair", lps: asVec3(plan?.centre_lps ?? target.lps) })}
          />
          <Act
            kind="quiet"
            label="Remove"
            words={`Remove ${target.name}`}
            onPress={() => station.send({ type: "remove_target", target_id: target.target_id })}
          />
        </span>
      </div>
    </li>
  );
}

/**
 * Render the description of a target as editable fields: Enter in the name saves the description, Escape restores it.
 */
function Describe({ target, onDone }: { target: Target; onDone: () => void }) {
  const station = useStation();
  const hint = useId();
  const [name, setName] = useState(target.name);
  const [note, setNote] = useState(target.note);
  const [priority, setPriority] = useState(target.priority);
  const keep = () => {
    if (name.trim() !== "") {
      station.send({
        type: "describe_target",
        target_id: target.target_id,
        called: name.trim(),
        remark: note.trim(),
        rank: priority,
      });
    }
    done();
  };
  const done = () => {
    onDone();
    if (document.activeElement instanceof HTMLElement) document.activeElement.blur();
  };
  return (
    <div className="describe">
      <TextField
        className="name-field"
        aria-label="Name of the target"
        value={name}
        onChange={setName}
        maxLength={80}
        autoFocus
        onKeyDown={(event) => {
          if (event.key === "Enter") keep();
          else if (event.key === "Escape") done();
          else event.continuePropagation();
        }}
      >
        <Input aria-describedby={hint} spellCheck="false" autoComplete="off" data-testid="target-name" />
      </TextField>
      <TextField
        value={note}
        onChange={setNote}
        maxLength={2000}
        onKeyDown={(event) => {
          if (event.key === "Escape") done();
          else event.continuePropagation();
        }}
      >
        <Label>Notes</Label>
        <TextArea rows={3} data-testid="target-note" />
      </TextField>
      <span className="row">
        <span className="quiet">Priority {priority}</span>
        <Act
          kind="quiet"
          label="Higher"
          words="1 comes first"
          disabled={priority <= 1}
          onPress={() => setPriority(priority - 1)}
        />
        <Act
          kind="quiet"
          label="Lower"
          words="1 comes first"
          disabled={priority >= 9}
          onPress={() => setPriority(priority + 1)}
        />
      </span>
      <span className="row">
        <Act label="Save" words="Keep name, priority and notes" testId="save-target" onPress={keep} />
        <Act kind="quiet" label="Cancel" words="Leave them as they were" onPress={done} />
      </span>
      <p id={hint} className="quiet small">
        Do not enter the patient's name: it would appear in the report.
      </p>
    </div>
  );
}

/** Render the controls that change a target's boundary (a diameter, or a brush) and its aim point. */
function Boundary({ target, plan }: { target: Target; plan: TargetPlan }) {
  const station = useStation();
  const armed = useApp((state) => (state.ui.brushedTarget === target.target_id ? state.ui.armed : null));
  const [text, setText] = useState<string | null>(null);
  const keep = () => {
    const diameter = text === null ? Number.NaN : Number(text.replace(",", "."));
    setText(null);
    if (diameter >= 1 && diameter <= 150) {
      station.send({ type: "resize_target", target_id: target.target_id, diameter_mm: diameter });
    }
  };
  return (
    <div className="describe" data-testid="boundary">
      <label>
        <span className="quiet">Longest diameter, mm</span>
        <input
          type="text"
          inputMode="decimal"
          data-testid="target-diameter"
          value={text ?? plan.long_mm.toFixed(1)}
          onChange={(event) => setText(event.target.value)}
          onBlur={keep}
          onKeyDown={(event) => {
            event.stopPropagation();
            if (event.key === "Enter") event.currentTarget.blur();
          }}
        />
      </label>
      <span className="row">
        <SwitchKey
          icon="paint"
          label="Paint"
          words="Add to the target with a brush, in a slice"
          on={armed === "lesion-add"}
          onChange={() => station.brushTarget(target.target_id, "lesion-add")}
        />
        <SwitchKey
          icon="erase"
          label="Erase"
          words="Take from the target with a brush, in a slice"
          on={armed === "lesion-cut"}
          onChange={() => station.brushTarget(target.target_id, "lesion-cut")}
        />
      </span>
      <Choice<"middle" | "periphery">
        name="Aims"
        value={plan.num_aims > 1 ? "periphery" : "middle"}
        choices={[
          { value: "middle", label: "Middle", words: "Aim at the middle of the target" },
          { value: "periphery", label: "And periphery", words: "Aim at the middle and at both ends of its long axis" },
        ]}
        onChange={(aims) =>
          station.send({ type: "aim_target", target_id: target.target_id, periphery: aims === "periphery" })
        }
      />
    </div>
  );
}
