import { useState } from "react";
import { FieldError, Form, Input, Label, TextField } from "react-aria-components";
import { keyOf } from "../../input/keymap";
import { mm, parseCoordinates, sentence } from "../../state/format";
import { asVec3, type Vec3 } from "../../state/vec";
import type { Target } from "../../wire/messages";
import { useApp, useStation } from "../context";
import { Act } from "../controls";
import { Icon } from "../icons";
import { PenWords } from "../ToolTag";

export function TargetStep() {
  const station = useStation();
  const targets = useApp((state) => state.session?.targets ?? null);
  const armed = useApp((state) => state.ui.armed === "target");
  return (
    <>
      <Act
        kind="primary"
        icon="target"
        label={armed ? "Click in a view\u2026" : "Mark a target"}
        words={armed ? "Stop marking" : "Click in any view to mark a target. The line shows the path to it."}
        keys={keyOf("arm_target")}
        testId="arm-target"
        onPress={() => station.act("arm_target")}
      />
      <PenWords />
      <Coordinates />
      {targets === null || targets.length === 0 ? (
        <p className="empty">Targets appear here, each with its path, or why no path leads there.</p>
      ) : (
        <ul className="targets">
          {targets.map((target) => (
            <TargetRow key={target.target_id} target={target} />
          ))}
        </ul>
      )}
    </>
  );
}

export function TargetRow({ target }: { target: Target }) {
  const station = useStation();
  const chosen = useApp((state) => state.route?.target_id === target.target_id);
  return (
    <li className={chosen ? "target chosen" : "target"} data-testid="target">
      <span className={target.problem === null ? "diamond" : "diamond problem"}>
        <Icon name={target.problem === null ? "target" : "warning"} />
      </span>
      <div>
        <strong>{target.name}</strong>
        {target.problem === null ? (
          <span className="quiet numbers">
            {target.length_mm === null ? "" : `${mm(target.length_mm, 0)} from the tracheal entry`}
            {target.snapped_mm === null || target.snapped_mm < 0.05
              ? ""
              : `, moved ${mm(target.snapped_mm)} into the lumen`}
          </span>
        ) : (
          <span className="warning-text">{sentence(target.problem)}</span>
        )}
        <span className="row">
          <Act
            kind="quiet"
            label={chosen ? "Route chosen" : "Choose route"}
            words={`Fly to ${target.name}`}
            disabled={target.problem !== null || chosen}
            onPress={() => station.chooseTarget(target.target_id)}
          />
          <Act
            kind="quiet"
            label="Show"
            words="Move the crosshair to this target"
            onPress={() => station.send({ type: "set_crosshair", lps: asVec3(target.used_lps ?? target.lps) })}
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

/** A point that was typed, in the scanner's coordinates. */
function Coordinates() {
  const station = useStation();
  const [text, setText] = useState("");
  const point = parseCoordinates(text);
  const use = (what: (lps: Vec3) => void) => {
    if (point !== null) what(point);
  };
  return (
    <Form
      className="coordinates"
      onSubmit={(event) => {
        event.preventDefault();
        if (point === null) return;
        station.send({ type: "add_target", lps: point });
        setText("");
        // Done with typing: the keys fly again.
        if (document.activeElement instanceof HTMLElement) document.activeElement.blur();
      }}
    >
      <TextField
        value={text}
        onChange={setText}
        isInvalid={text.trim() !== "" && point === null}
        data-testid="coordinates"
      >
        <Label>or type x, y, z (LPS mm)</Label>
        <Input placeholder="-17.6, 35.3, 12.1" spellCheck="false" autoComplete="off" inputMode="text" />
        <FieldError>Three numbers: left, posterior, superior</FieldError>
      </TextField>
      <span className="row">
        <Act
          label="Add"
          words="Add this point as a target"
          keys="Enter"
          disabled={point === null}
          onPress={() => use((lps) => station.send({ type: "add_target", lps }))}
        />
        <Act
          label="Show"
          words="Move the crosshair to this point"
          disabled={point === null}
          onPress={() => use((lps) => station.send({ type: "set_crosshair", lps }))}
        />
        <Act
          label="Fly there"
          words="Move the tip to this point (free movement)"
          disabled={point === null}
          onPress={() => use((lps) => station.send({ type: "place", lps }))}
        />
      </span>
    </Form>
  );
}
