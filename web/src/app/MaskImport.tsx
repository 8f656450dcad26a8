/** Import of an external mask as the airways: file selection, drop, and the question about the contents of the mask. */

import { type DragEvent, useEffect, useState } from "react";
import {
  Button,
  Dialog,
  FileTrigger,
  Heading,
  Label,
  Modal,
  ModalOverlay,
  Radio,
  RadioGroup,
} from "react-aria-components";
import { filesOfDrop, filesOfPicker } from "../net/upload";
import { firstChoice, labelTitle, lostText, questionText, questionTitle, volumeText } from "../state/mask-question";
import type { MaskQuestion } from "../wire/messages";
import { useApp, useStation } from "./context";
import { Tip } from "./controls";
import { Icon } from "./icons";

/** Render a button that selects a mask file with the system's dialog. The file can also be dropped on the window. */
export function MaskPicker() {
  const station = useStation();
  return (
    <div className="mask-part">
      <p className="quiet">To use another segmentation instead, drop it on this window or choose its file.</p>
      <FileTrigger
        allowsMultiple
        onSelect={(list) => {
          if (list !== null && list.length > 0) void station.transfers.upload(filesOfPicker(list), "mask");
        }}
      >
        <Tip words="A segmentation of this scan as NIfTI, NRRD, MetaImage or DICOM SEG. Undo restores the current airways.">
          <Button className="button" data-testid="choose-mask">
            <Icon name="file" />
            {"Choose a segmentation\u2026"}
          </Button>
        </Tip>
      </FileTrigger>
    </div>
  );
}

/** Render the two drop areas while files are dragged over the window: open them as a case, or as the airways. */
export function DropChoice() {
  const station = useStation();
  const [dragged, setDragged] = useState(false);
  const [over, setOver] = useState<"mask" | "case" | null>(null);
  // While the question about an earlier mask is open, no second mask is accepted.
  const hasQuestion = useApp((state) => state.session?.mask_question != null);
  useEffect(() => {
    const end = () => {
      setDragged(false);
      setOver(null);
    };
    const drag = (event: globalThis.DragEvent) => {
      if (event.dataTransfer?.types.includes("Files") !== true) return;
      // Prevent the default action of the browser, which would leave the page and show the file.
      event.preventDefault();
      setDragged(true);
    };
    const leave = (event: globalThis.DragEvent) => {
      if (event.relatedTarget === null) end();
    };
    const drop = (event: globalThis.DragEvent) => {
      event.preventDefault();
      end();
    };
    window.addEventListener("dragenter", drag);
    window.addEventListener("dragover", drag);
    window.addEventListener("dragleave", leave);
    window.addEventListener("drop", drop);
    return () => {
      window.removeEventListener("dragenter", drag);
      window.removeEventListener("dragover", drag);
      window.removeEventListener("dragleave", leave);
      window.removeEventListener("drop", drop);
    };
  }, []);
  if (!dragged || hasQuestion) return null;
  const place = (use: "mask" | "case", title: string, words: string) => (
    // biome-ignore lint/a11y/noStaticElementInteractions: buttons in the panels give keyboard access
    <div
      className={over === use ? "drop over" : "drop"}
      data-testid={`drop-${use}`}
      onDragOver={() => setOver(use)}
      onDragLeave={() => setOver(null)}
      onDrop={(event: DragEvent) => {
        event.preventDefault();
        void filesOfDrop(event.dataTransfer.items).then((files) => station.transfers.upload(files, use));
      }}
    >
      <Icon name={use === "mask" ? "fork" : "folder"} />
      <p>
        <strong>{title}</strong>
        <br />
        <span className="quiet">{words}</span>
      </p>
    </div>
  );
  return (
    <section className="drop-choice" aria-label="Use of the dropped files">
      {place("mask", "Use for the airways of this scan", "a segmentation: NIfTI, NRRD, MetaImage, DICOM SEG")}
      {place(
        "case",
        "Open as another case",
        "a CT (a DICOM series, an archive, NIfTI, NRRD, MetaImage or VTI) or a Carina case",
      )}
    </section>
  );
}

/** Render the question about the contents of an imported mask; nothing without a question. */
export function MaskDialog() {
  const station = useStation();
  const question = useApp((state) => state.session?.mask_question ?? null);
  return (
    <ModalOverlay
      className="dialog-back"
      isOpen={question !== null}
      onOpenChange={(open) => {
        if (!open) station.send({ type: "dismiss_mask" });
      }}
    >
      <Modal className="dialog mask-dialog">
        {question === null ? null : <Question key={`${question.title} ${question.problem}`} question={question} />}
      </Modal>
    </ModalOverlay>
  );
}

function Question({ question }: { question: MaskQuestion }) {
  const station = useStation();
  const [label, setLabel] = useState(firstChoice(question));
  const isLabel = question.problem === "label";
  const lost = lostText(question);
  return (
    <Dialog data-testid="mask-question">
      <Heading slot="title">{questionTitle(question)}</Heading>
      <p>{questionText(question)}</p>
      {isLabel ? (
        <RadioGroup
          className="mask-labels"
          value={label === null ? null : String(label)}
          onChange={(value) => setLabel(Number(value))}
        >
          <Label className="visually-hidden">Structures in the segmentation</Label>
          {question.labels.map((one) => (
            <Radio key={one.number} value={String(one.number)} className="mask-label">
              <span>{labelTitle(one)}</span>
              <span className="quiet numbers">{one.name === null ? "" : one.number}</span>
              <span className="numbers">{volumeText(one.volume_ml)}</span>
            </Radio>
          ))}
        </RadioGroup>
      ) : (
        <>
          <dl className="facts">
            <div>
              <dt>This scan</dt>
              <dd className="numbers">{question.expected}</dd>
            </div>
            <div>
              <dt>Segmentation</dt>
              <dd className="numbers">{question.found}</dd>
            </div>
          </dl>
          {lost === null ? null : <p className="warning">{lost}</p>}
          <p>
            It can be resampled to the scan{"\u2019"}s grid: each voxel takes the value of the nearest voxel of the
            segmentation, so edges stay as coarse as in the original. Compare the result with the slices, or export the
            segmentation again on the scan{"\u2019"}s grid.
          </p>
        </>
      )}
      <p className="quiet">The current airways remain until you choose. Undo restores them afterwards.</p>
      <div className="dialog-actions">
        <Button className="button" onPress={() => station.send({ type: "dismiss_mask" })}>
          Cancel
        </Button>
        <Button
          className="button primary"
          data-testid="mask-answer"
          isDisabled={isLabel && label === null}
          onPress={() => station.send({ type: "answer_mask", label: isLabel ? label : null, resample: !isLabel })}
        >
          {isLabel ? "Use for the airways" : "Resample to the scan"}
        </Button>
      </div>
    </Dialog>
  );
}
