/** Top bar: product name, case title, steps of the workflow, and the saved state. */

import { Fragment } from "react";
import { Button } from "react-aria-components";
import { keyOf } from "../input/keymap";
import { isInserted, withoutHuNote } from "../state/badges";
import { plural, sentence } from "../state/format";
import { STEP_TEXTS, STEPS } from "../state/steps";
import { trainingLayout } from "../state/training";
import { watchingText } from "../state/watching";
import type { CaseNote } from "../wire/messages";
import { useApp, useStation } from "./context";
import { Act, Tip } from "./controls";
import { SavedText } from "./SavedText";

const NONE: readonly CaseNote[] = [];

/** Render the text beside the title of a CT with an inserted nodule. */
function InsertedText() {
  return (
    <strong className="badge warning plain-text" data-testid="inserted">
      Inserted nodule
    </strong>
  );
}

/** Render the top bar. */
export function TopBar() {
  const station = useStation();
  const title = useApp((state) => state.session?.saving.title ?? state.session?.case?.title ?? "");
  const ctName = useApp((state) => state.session?.case?.ct_name ?? null);
  const neutral = useApp((state) => state.session?.case?.title ?? "");
  const isHu = useApp((state) => state.session?.case?.is_hu ?? true);
  const reason = useApp((state) => state.session?.case?.not_hu_reason ?? null);
  const badges = useApp((state) => state.session?.badges ?? NONE);
  const doubts = withoutHuNote(badges);
  const trains = useApp((state) => trainingLayout(state) !== undefined);
  const step = useApp((state) => (trains ? "train" : state.ui.step));
  const watches = useApp((state) => state.watches);
  const page = useApp((state) => state.watching?.page ?? null);
  if (watches) {
    return (
      <header className="top-bar">
        <h1>Carina</h1>
        <p className="case-title">{title}</p>
        {badges.some(isInserted) ? <InsertedText /> : null}
        {doubts.length === 0 ? null : (
          <Tip words={doubts.map(({ words }) => sentence(words)).join(" ")}>
            <Button className="badge warning">{plural(doubts.length, "finding")}</Button>
          </Tip>
        )}
        <span className="space" />
        <strong data-testid="watching">View only</strong>
        <KeyCardButton />
      </header>
    );
  }
  return (
    <header className="top-bar">
      <h1>Carina</h1>
      <CaseTitle title={title} neutral={neutral} ctName={ctName} />
      {badges.some(isInserted) ? <InsertedText /> : null}
      <SavedText />
      {page === null ? null : (
        <Tip words="Your patient's images are on the network. Open Devices to see who is watching, or to stop sharing.">
          <Button
            className="badge warning"
            data-testid="on-network"
            onPress={() => (station.state.ui.devicesOpen ? undefined : station.act("devices"))}
          >
            {watchingText(page)}
          </Button>
        </Tip>
      )}
      {isHu ? null : (
        <Tip words={reason ?? "This volume is not in Hounsfield units."}>
          <Button className="badge warning" onPress={() => station.toStep("check")} data-testid="not-hu">
            not HU
          </Button>
        </Tip>
      )}
      {doubts.length === 0 ? null : (
        <Tip words={doubts.map(({ words }) => sentence(words)).join(" ")}>
          <Button className="badge warning" onPress={() => station.toStep("check")} data-testid="doubts">
            {plural(doubts.length, "finding")}
          </Button>
        </Tip>
      )}
      <nav aria-label="Steps">
        <ol className="steps">
          {STEPS.map((name, index) => {
            const { title: words, words: tip } = STEP_TEXTS[name];
            return (
              <Fragment key={name}>
                {index === 0 ? null : (
                  <li className="arrow" aria-hidden="true">
                    {"\u203a"}
                  </li>
                )}
                <li>
                  <Tip words={tip}>
                    <Button
                      className="step"
                      data-step={name}
                      aria-current={name === step ? "step" : undefined}
                      isDisabled={trains && name !== step}
                      onPress={(event) => {
                        if (event.pointerType === "mouse" && document.activeElement instanceof HTMLElement) {
                          document.activeElement.blur();
                        }
                        station.toStep(name);
                      }}
                    >
                      {words}
                    </Button>
                  </Tip>
                </li>
              </Fragment>
            );
          })}
        </ol>
      </nav>
      <Act
        kind="quiet"
        label="Devices"
        words="Gamepad, SpaceMouse, trackers, pens, scope handle; recording"
        keys={keyOf("devices")}
        disabled={trains}
        testId="open-devices"
        onPress={() => station.act("devices")}
      />
      <KeyCardButton />
    </header>
  );
}

/**
 * Render the case title. The file name of the CT is shown only on this computer and only on request, because the name
 * may identify the patient.
 */
function CaseTitle({ title, neutral, ctName }: { title: string; neutral: string; ctName: string | null }) {
  if (title === "") return null;
  const ct = ctName === null ? "" : `CT: ${ctName}. `;
  return (
    <p className="case-title" data-testid="case-title" title={`${ct}Observers see this case as ${neutral}.`}>
      {title}
    </p>
  );
}

function KeyCardButton() {
  const station = useStation();
  return (
    <Act
      kind="icon"
      label="?"
      words="Keys, mouse and tour"
      testId="open-key-card"
      keys={keyOf("key_card")}
      onPress={() => station.ui({ keyCardOpen: true })}
    />
  );
}
