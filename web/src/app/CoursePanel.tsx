/** Course in the step Train: choice, addition and removal of learners, and the dialog with the learning curves. */

import { useState } from "react";
import {
  Button,
  Dialog,
  Heading,
  Input,
  ListBox,
  ListBoxItem,
  Modal,
  ModalOverlay,
  Popover,
  Select,
  SelectValue,
  TextField,
} from "react-aria-components";
import { keyOf } from "../input/keymap";
import { attemptText, type Curve, countsText, curvePlaces, curvesOf, curveTop } from "../state/course";
import { sentence } from "../state/format";
import type { CourseInfo } from "../wire/messages";
import { useApp, useStation } from "./context";
import { Act, Tip, useKeysBack } from "./controls";
import { Icon } from "./icons";

/** Maximum length of a pseudonym. */
const MAX_NAME = 40;

/** Render the choice of the learner whose attempts are stored. */
export function CoursePanel({ course }: { course: CourseInfo }) {
  const station = useStation();
  if (!course.stores) return null;
  return (
    <>
      <h3>Learner</h3>
      <LearnerSelect course={course} />
      <div className="row">
        {course.chosen === null ? null : (
          <Act
            label="Progress"
            words={`Show the learning curves and the attempts of ${course.chosen}`}
            testId="open-course"
            onPress={() => station.ui({ courseOpen: true })}
          />
        )}
        <NewLearner />
      </div>
      {course.problems.map((words) => (
        <p key={words} className="warning-text">
          <Icon name="warning" /> {sentence(words)}
        </p>
      ))}
    </>
  );
}

/** Key of the choice "no learner"; the key of a learner has at least one character. */
const NOBODY = "";

function LearnerSelect({ course }: { course: CourseInfo }) {
  const station = useStation();
  const keysBack = useKeysBack();
  return (
    <Select
      aria-label="Learner whose scores are stored"
      className="select"
      onOpenChange={keysBack.onOpenChange}
      selectedKey={course.chosen ?? NOBODY}
      onSelectionChange={(key) => {
        const name = key === NOBODY || key === null ? null : String(key);
        if (name !== course.chosen) station.send({ type: "choose_learner", name });
      }}
    >
      <Tip words="Choose the learner whose scores are stored on this machine">
        <Button className="button" data-testid="learner" onPressStart={keysBack.onPressStart}>
          <SelectValue>{() => course.chosen ?? "Nobody: scores are not stored"}</SelectValue>
          <Icon name="down" />
        </Button>
      </Tip>
      <Popover className="popover" offset={4}>
        <ListBox className="listbox">
          <ListBoxItem id={NOBODY} textValue="Nobody" className="listbox-item">
            <span>Nobody</span>
            <span className="item-words">scores are not stored</span>
          </ListBoxItem>
          {course.learners.map(({ name, num_attempts: num }) => (
            <ListBoxItem key={name} id={name} textValue={name} className="listbox-item">
              <span>{name}</span>
              <span className="item-words numbers">
                {num} {num === 1 ? "attempt" : "attempts"}
              </span>
            </ListBoxItem>
          ))}
        </ListBox>
      </Popover>
    </Select>
  );
}

/** Render the button and the field that add a learner. */
function NewLearner() {
  const station = useStation();
  const [name, setName] = useState<string | null>(null);
  if (name === null) {
    return (
      <Act
        label="New learner"
        words="Add a learner by a pseudonym. The scores stay on this machine."
        testId="new-learner"
        onPress={() => setName("")}
      />
    );
  }
  const add = () => {
    if (name.trim() !== "") station.send({ type: "add_learner", name });
    setName(null);
  };
  return (
    <TextField className="field" aria-label="Pseudonym" maxLength={MAX_NAME} value={name} onChange={setName} autoFocus>
      <Input
        placeholder="Pseudonym, not a real name"
        data-testid="learner-name"
        onKeyDown={(event) => {
          if (event.key === "Enter") add();
          else if (event.key === "Escape") setName(null);
        }}
        onBlur={add}
      />
    </TextField>
  );
}

/** Render the dialog with the learning curves, the attempts and the deletion of the chosen learner. */
export function CourseDialog() {
  const station = useStation();
  const open = useApp((state) => state.ui.courseOpen);
  const course = useApp((state) => state.training?.course ?? null);
  const close = () => station.ui({ courseOpen: false });
  const name = course?.chosen ?? null;
  return (
    <ModalOverlay className="dialog-back" isOpen={open && name !== null} isDismissable onOpenChange={close}>
      <Modal className="dialog score-dialog">
        <Dialog data-testid="course-dialog">
          {course === null || name === null ? null : (
            <>
              <div className="dialog-head">
                <Heading slot="title">{name}</Heading>
                <Act
                  icon="file"
                  label="Export"
                  words="Save all attempts as CSV, and as xAPI statements"
                  testId="export-learner"
                  onPress={() => void station.transfers.takeLearner(name)}
                />
                <DeleteLearner name={name} num={course.attempts.length} onDelete={close} />
                <Act kind="icon" icon="close" words="Close" keys={keyOf("leave")} onPress={close} />
              </div>
              <CourseContent course={course} />
            </>
          )}
        </Dialog>
      </Modal>
    </ModalOverlay>
  );
}

/** Render the button that deletes a learner, and its question. */
function DeleteLearner({ name, num, onDelete }: { name: string; num: number; onDelete: () => void }) {
  const station = useStation();
  const [asked, setAsked] = useState(false);
  if (!asked) {
    return (
      <Act
        icon="erase"
        label="Delete"
        words={`Delete ${name} and all attempts; Carina asks first`}
        testId="delete-learner"
        onPress={() => setAsked(true)}
      />
    );
  }
  return (
    <>
      <span role="status">
        Delete {name} and {num} {num === 1 ? "attempt" : "attempts"} from this machine?
      </span>
      <Act
        kind="primary"
        label="Delete now"
        words="This cannot be undone. The flights in the cases remain."
        testId="delete-learner-now"
        onPress={() => {
          onDelete();
          station.send({ type: "remove_learner", name });
        }}
      />
      <Act label="Cancel" words="Delete nothing" onPress={() => setAsked(false)} />
    </>
  );
}

function CourseContent({ course }: { course: CourseInfo }) {
  const groups = useApp((state) => state.training?.references ?? null) ?? [];
  const learner = course.learners.find(({ name }) => name === course.chosen);
  const curves = curvesOf(course, groups).filter(({ points }) => points.length > 0);
  return (
    <div className="score-content">
      <p data-testid="course-verdict">{learner === undefined ? "" : sentence(learner.verdict)}</p>
      {curves.length === 0 ? (
        <p className="quiet">The curves begin with the first inspection of all segments.</p>
      ) : (
        <div className="curves">
          {curves.map((curve) => (
            <CurveChart key={curve.title} curve={curve} />
          ))}
        </div>
      )}
      {curves.length === 0 ? null : (
        <p className="quiet">
          Filled points count in the verdict. Dashed lines: {groups[0]?.source}, measured with another system; not
          directly comparable, and no pass marks.
        </p>
      )}
      <table className="score-table numbers" data-testid="course-attempts">
        <thead>
          <tr>
            <th scope="col">Attempt</th>
            <th scope="col">Result</th>
            <th scope="col">Counts</th>
          </tr>
        </thead>
        <tbody>
          {course.attempts.map((one) => (
            <tr key={one.number}>
              <th scope="row">
                {one.number}. {one.title}
              </th>
              <td>{attemptText(one)}</td>
              <td>{countsText(one)}</td>
            </tr>
          ))}
        </tbody>
      </table>
    </div>
  );
}

/** Width and height of the box of a learning curve, px. */
const WIDTH = 200;
const HEIGHT = 70;

function CurveChart({ curve }: { curve: Curve }) {
  const places = curvePlaces(curve, WIDTH, HEIGHT);
  const top = curveTop(curve);
  const latest = curve.points.at(-1);
  return (
    <figure className="curve">
      <figcaption>
        {curve.title}: <strong>{latest === undefined ? "" : curve.text(latest.value)}</strong>
      </figcaption>
      <svg viewBox={`-6 -6 ${WIDTH + 12} ${HEIGHT + 12}`} role="img" aria-label={curveWords(curve)}>
        {curve.marks.map(({ group, value }) => (
          <line
            key={group}
            className="curve-mark"
            x1={0}
            x2={WIDTH}
            y1={HEIGHT * (1 - value / top)}
            y2={HEIGHT * (1 - value / top)}
          >
            <title>{`${group}: ${curve.text(value)}`}</title>
          </line>
        ))}
        <polyline className="curve-line" points={places.map(({ x, y }) => `${x},${y}`).join(" ")} />
        {curve.points.map(({ attempt, value, counts }, n) => (
          <circle
            key={attempt}
            className="curve-point"
            data-counts={counts || undefined}
            cx={places[n]?.x}
            cy={places[n]?.y}
            r={3.5}
          >
            <title>{`Attempt ${attempt}: ${curve.text(value)}`}</title>
          </circle>
        ))}
      </svg>
    </figure>
  );
}

const curveWords = (curve: Curve): string =>
  `${curve.title} over the attempts: ${curve.points.map(({ value }) => curve.text(value)).join(", ")}`;
