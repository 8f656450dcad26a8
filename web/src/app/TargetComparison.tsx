/** Dialog that compares the planned targets of the case in one table, in the order of the server. */

import { Dialog, Heading, Modal, ModalOverlay } from "react-aria-components";
import { keyOf } from "../input/keymap";
import { sentence } from "../state/format";
import { COMPARED_COLUMNS } from "../state/target-comparison";
import type { PlannedTargetRow, TargetComparison, UnplannedTarget } from "../wire/messages";
import { useApp, useStation } from "./context";
import { Act } from "./controls";
import { Icon } from "./icons";

/** Render the button that opens the comparison; nothing in a case with fewer than two targets. */
export function CompareTargets() {
  const station = useStation();
  const there = useApp((state) => (state.plans?.comparison ?? null) !== null);
  if (!there) return null;
  return (
    <Act
      kind="plain"
      label="Compare the targets"
      words="Show all targets in one table, the best first"
      testId="compare-targets"
      onPress={() => station.ui({ comparisonOpen: true })}
    />
  );
}

/** Render the dialog that compares the targets. */
export function TargetComparisonDialog() {
  const station = useStation();
  const comparison = useApp((state) => state.plans?.comparison ?? null);
  const open = useApp((state) => state.ui.comparisonOpen);
  const close = () => station.ui({ comparisonOpen: false });
  return (
    <ModalOverlay
      className="dialog-back"
      isOpen={open && comparison !== null}
      isDismissable
      onOpenChange={(comparisonOpen) => station.ui({ comparisonOpen })}
    >
      <Modal className="dialog comparison-dialog">
        <Dialog data-testid="comparison">
          <div className="dialog-head">
            <Heading slot="title">Comparison of the targets</Heading>
            <Act kind="icon" icon="close" words="Close" keys={keyOf("leave")} onPress={close} />
          </div>
          {comparison === null ? null : <Table comparison={comparison} />}
        </Dialog>
      </Modal>
    </ModalOverlay>
  );
}

function Table({ comparison }: { comparison: TargetComparison }) {
  return (
    <>
      <p className="quiet">{comparison.order}</p>
      <div className="routes-scroll">
        <table className="routes compared numbers">
          <thead>
            <tr>
              <th scope="col">Target</th>
              {COMPARED_COLUMNS.map(({ title, words }) => (
                <th scope="col" key={title} title={words}>
                  {title}
                </th>
              ))}
              <th scope="col" title="Outlook, hits, needle and vessel have columns beside this one">
                Doubts about target and airways
              </th>
            </tr>
          </thead>
          <tbody>
            {comparison.targets.map((row) => (
              <PlannedRow key={row.target_id} row={row} />
            ))}
            {comparison.unplanned.map((row) => (
              <UnplannedRow key={row.target_id} row={row} />
            ))}
          </tbody>
        </table>
      </div>
    </>
  );
}

function PlannedRow({ row }: { row: PlannedTargetRow }) {
  const chosen = useApp((state) => state.route?.target_id === row.target_id);
  return (
    <tr className={chosen ? "chosen" : undefined} data-testid="compared" aria-current={chosen || undefined}>
      <th scope="row">
        <Choose targetId={row.target_id} name={row.name} possible={row.route !== null} />
      </th>
      {COMPARED_COLUMNS.map(({ title, of }) => (
        <td key={title}>{of(row)}</td>
      ))}
      <td className="compared-doubts">
        {row.doubts.length === 0 ? (
          "none"
        ) : (
          <ul>
            {row.doubts.map((doubt) => (
              <li key={doubt}>{sentence(doubt)}</li>
            ))}
          </ul>
        )}
      </td>
    </tr>
  );
}

function UnplannedRow({ row }: { row: UnplannedTarget }) {
  const target = useApp((state) => state.session?.targets.find((one) => one.target_id === row.target_id) ?? null);
  const chosen = useApp((state) => state.route?.target_id === row.target_id);
  const hasPath = target !== null && !target.has_size && target.problem === null;
  return (
    <tr className={chosen ? "chosen" : undefined} data-testid="unplanned" aria-current={chosen || undefined}>
      <th scope="row">
        <Choose targetId={row.target_id} name={target?.name ?? ""} possible={hasPath} />
      </th>
      <td className="compared-doubts" colSpan={1 + COMPARED_COLUMNS.length}>
        <span className="warning-text">
          <Icon name="warning" /> {sentence(row.why)}
        </span>
      </td>
    </tr>
  );
}

/** Render the name of a target as the button that chooses it; as text if the target has no path. */
function Choose({ targetId, name, possible }: { targetId: string; name: string; possible: boolean }) {
  const station = useStation();
  if (!possible) return <strong>{name}</strong>;
  return (
    <Act
      kind="plain"
      label={name}
      words={`Choose ${name} and show its route`}
      testId={`choose-${targetId}`}
      onPress={() => station.chooseComparedTarget(targetId)}
    />
  );
}
