import { useState } from "react";
import { Button, FieldError, FileTrigger, Form, Input, Label, TextField } from "react-aria-components";
import { keyOf } from "../../input/keymap";
import { filesOfPicker } from "../../net/upload";
import { coordinates, parseCoordinates, sentence } from "../../state/format";
import { ALL_COSTS, COST_TEXTS, offeredCosts, type PathCost, pathText, startOf } from "../../state/path-search";
import { isMarkAt, marksStructure } from "../../state/target-mark";
import { asVec3, type Vec3 } from "../../state/vec";
import type { Target } from "../../wire/messages";
import { useApp, useStation } from "../context";
import { Act, Choice, SwitchKey, Tip } from "../controls";
import { Icon } from "../icons";
import { CompareTargets } from "../TargetComparison";
import { PenText } from "../ToolTag";
import { LesionCard } from "./LesionCard";
import { LungsPanel } from "./LungsPanel";
import { useReachOf } from "./reach-of";

/** Render the panel of the Target step. */
export function TargetStep() {
  const station = useStation();
  const targets = useApp((state) => state.session?.targets ?? null);
  const armed = useApp((state) => state.ui.armed === "target");
  const found = useApp((state) => state.session?.airways === "found");
  const cost = useApp((state) => state.ui.pathCost);
  const reach = useReachOf();
  return (
    <>
      {found ? null : <PathSearch costs={offeredCosts(cost)} />}
      <Act
        kind="primary"
        icon="target"
        label={armed ? "Click in a view\u2026" : "Mark a target"}
        words={armed ? "Stop marking" : "Click a nodule, or a place in the airways, in any view."}
        keys={keyOf("arm_target")}
        testId="arm-target"
        onPress={() => station.act("arm_target")}
      />
      {found && cost !== "lumen" ? (
        <p className="quiet" data-testid="path-search-cost">
          Path search: {COST_TEXTS[cost].label} (see Details)
        </p>
      ) : null}
      <PenText />
      <MarkText />
      {targets === null || targets.length === 0 ? (
        <p className="empty">Targets appear here, each with its path, or why no path leads there.</p>
      ) : (
        <TargetList targets={targets} />
      )}
      <Coordinates />
      <FromFile />
      <LungsPanel scope={reach.scope} tool={reach.tool} />
      <Details />
    </>
  );
}

/** Render what few users need: how coordinates are typed as numbers, and the cost functions of the path search. */
function Details() {
  const station = useStation();
  const found = useApp((state) => state.session?.airways === "found");
  const paper = useApp((state) => state.ui.pathCost === "paper");
  return (
    <details className="part target-details" data-testid="target-details">
      <summary>Details</summary>
      <p className="quiet">A typed position may also be three numbers: x, y, z (LPS mm), such as −17.6, 35.3, 12.1.</p>
      {found ? (
        <PathSearch costs={ALL_COSTS} />
      ) : (
        <SwitchKey
          label={COST_TEXTS.paper.label}
          words={COST_TEXTS.paper.words}
          on={paper}
          testId="cost-paper"
          onChange={() => station.choosePathCost(paper ? "lumen" : "paper")}
        />
      )}
    </details>
  );
}

/** Render what a click at the cursor would mark, also for users who cannot see the text beside the cursor. */
function MarkText() {
  const words = useApp((state) => {
    const mark = marksStructure(state) && isMarkAt(state.targetMark, state.ui.pointedLps) ? state.targetMark : null;
    return mark === null ? "" : mark.sentences.map((line) => `${sentence(line)}.`).join(" ");
  });
  return (
    <p className="quiet" role="status" data-testid="target-mark" hidden={words === ""}>
      {words}
    </p>
  );
}

/**
 * Render the selection of the path search's cost function, and the start point for cost functions that need no airways.
 */
function PathSearch({ costs }: { costs: readonly PathCost[] }) {
  const station = useStation();
  const cost = useApp((state) => state.ui.pathCost);
  const found = useApp((state) => state.session?.airways === "found");
  const armed = useApp((state) => state.ui.armed === "start");
  // Return the start point as text, because a selector must return the same value for an unchanged state and an array
  // would be new each time.
  const start = useApp((state) => {
    const lps = startOf(state.ui, state.session);
    return lps === null ? null : coordinates(lps);
  });
  return (
    <div className="path-search" data-testid="path-search">
      <h3>Path search</h3>
      <Choice<PathCost>
        name="Path search"
        value={cost}
        choices={costs.map((value) => ({ value, ...COST_TEXTS[value] }))}
        onChange={(chosen) => station.choosePathCost(chosen)}
      />
      {cost === "lumen" ? (
        found ? null : (
          <p className="quiet">
            There are no airways to follow. In any scan, “Walls” finds a path between two points that you mark.
          </p>
        )
      ) : (
        <>
          <p className="quiet numbers" data-testid="path-start">
            Start: {start ?? "not marked yet"}
          </p>
          <SwitchKey
            icon="root"
            label={armed ? "Click in a view\u2026" : "Mark the start"}
            words="Click in any view where the path should start. The paths to existing targets do not change."
            on={armed}
            testId="arm-start"
            onChange={() => station.arm("start")}
          />
        </>
      )}
    </div>
  );
}

/** Render the targets of the case, with a button that compares them. */
export function TargetList({ targets }: { targets: readonly Target[] }) {
  return (
    <>
      <CompareTargets />
      <ul className="targets">
        {targets.map((target) =>
          target.has_size ? (
            <LesionCard key={target.target_id} target={target} />
          ) : (
            <TargetRow key={target.target_id} target={target} />
          ),
        )}
      </ul>
    </>
  );
}

/** Render one target as a row of the list of targets. */
function TargetRow({ target }: { target: Target }) {
  const station = useStation();
  const chosen = useApp((state) => state.route?.target_id === target.target_id);
  const isHu = useApp((state) => state.session?.case?.is_hu ?? false);
  return (
    <li className={chosen ? "target chosen" : "target"} data-testid="target">
      <span className={target.problem === null ? "diamond" : "diamond problem"}>
        <Icon name={target.problem === null ? "target" : "warning"} />
      </span>
      <div>
        <strong>{target.name}</strong>
        {target.problem === null ? (
          <span className="quiet numbers" data-testid="target-words">
            {pathText(target, isHu)}
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
          {target.cost === "lumen" && target.snapped_mm !== null && target.snapped_mm > 0.05 ? (
            <Act
              kind="quiet"
              label="Segment as nodule"
              words="Find the boundary of what was clicked beside the airway"
              onPress={() => station.send({ type: "grow_target", target_id: target.target_id })}
            />
          ) : null}
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

/** Render the import of targets that were drawn in another program. */
function FromFile() {
  const station = useStation();
  const [structure, setStructure] = useState("");
  return (
    <details className="plan-options">
      <summary>Target from a file</summary>
      <label>
        Structure, if the file has several
        <input
          type="text"
          value={structure}
          placeholder="name or number"
          maxLength={80}
          onChange={(event) => setStructure(event.target.value)}
          onKeyDown={(event) => event.stopPropagation()}
        />
      </label>
      <FileTrigger
        allowsMultiple
        onSelect={(list) => {
          if (list !== null && list.length > 0)
            void station.transfers.upload(filesOfPicker(list), "target", {
              structure: structure.trim() === "" ? null : structure.trim(),
            });
        }}
      >
        <Tip words="A mask of the target (NIfTI, NRRD, MetaImage), a DICOM SEG or an RTSTRUCT">
          <Button className="button" data-testid="choose-target">
            <Icon name="file" />
            {"Choose a file\u2026"}
          </Button>
        </Tip>
      </FileTrigger>
    </details>
  );
}

/** Render the input of a target's coordinates in the scanner's frame (LPS). */
function Coordinates() {
  const station = useStation();
  const [text, setText] = useState("");
  const point = parseCoordinates(text);
  const use = (what: (lps: Vec3) => void) => {
    if (point !== null) what(point);
  };
  const add = () =>
    use((lps) => {
      station.addTarget(lps);
      setText("");
    });
  return (
    <Form
      className="coordinates"
      onSubmit={(event) => {
        event.preventDefault();
        if (point === null) return;
        add();
        // Remove the focus from the field after the input, so that the keys move the tip again.
        if (document.activeElement instanceof HTMLElement) document.activeElement.blur();
      }}
    >
      <TextField
        value={text}
        onChange={setText}
        isInvalid={text.trim() !== "" && point === null}
        data-testid="coordinates"
      >
        <Label>or type a position, in mm</Label>
        <Input placeholder="R 17.6 P 35.3 S 12.1" spellCheck="false" autoComplete="off" inputMode="text" />
        <FieldError>
          Type the notation of the pictures, such as R 17.6 P 35.3 S 12.1, or three numbers (see Details).
        </FieldError>
      </TextField>
      <span className="row">
        <Act label="Add" words="Add this point as a target" keys="Enter" disabled={point === null} onPress={add} />
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
