/**
 * Panel of the selected branch: its name with confidence, its measurements with errors, and a chart of the lumen
 * diameter.
 */

import { useEffect, useId, useState } from "react";
import { Input, TextField } from "react-aria-components";
import { keyOf } from "../input/keymap";
import type { BranchNode } from "../state/airways";
import { shownBranch } from "../state/app-state";
import { drawnText, factsOf, nameText } from "../state/branch-text";
import { sentence } from "../state/format";
import { measuredPoints } from "../state/profile";
import { useApp, useStation } from "./context";
import { Act } from "./controls";
import { Icon } from "./icons";
import { ProfileChart } from "./ProfileChart";

let requests = 0;

/** Render the panel of the selected branch. */
export function BranchPanel() {
  const station = useStation();
  const id = useApp(shownBranch);
  const tree = useApp((state) => state.tree);
  const node = id === null ? undefined : tree?.byId.get(id);
  const measured = node?.measures ?? null;
  // biome-ignore lint/correctness/useExhaustiveDependencies: new measurements include a profile
  useEffect(() => {
    if (id === null) return;
    requests += 1;
    station.send({ type: "branch_detail", request_id: requests, branch_id: id });
  }, [station, id, measured]);
  if (tree === null) return null;
  if (node === undefined) {
    return <p className="empty">Choose a branch in the list or in a view to see its measurements.</p>;
  }
  const drawn = drawnText(node);
  return (
    <section className="branch-panel" aria-label={`Branch ${node.label}`} data-testid="branch-panel">
      <BranchName node={node} />
      {drawn === null ? null : (
        <p className="warning-text" data-testid="branch-drawn">
          <Icon name="warning" /> {drawn}
        </p>
      )}
      {node.branch.variant === null ? null : (
        <p className="variant">
          <Icon name="info" /> {sentence(node.branch.variant)}
        </p>
      )}
      {node.branch.kind === "manual" ? null : <Chart node={node} />}
      <dl className="facts">
        {factsOf(node).map((fact) => (
          <div key={fact.term}>
            <dt>{fact.term}</dt>
            <dd className={fact.warns === true ? "numbers warning-text" : "numbers"}>{fact.value}</dd>
          </div>
        ))}
      </dl>
    </section>
  );
}

function Chart({ node }: { node: BranchNode }) {
  const profile = useApp((state) => (state.detail?.branch_id === node.branch.id ? state.detail.profile : null));
  if (profile === null) return <p className="empty">Not measured yet.</p>;
  return (
    <ProfileChart
      points={measuredPoints(profile)}
      title={`Lumen along ${node.label}`}
      words="Lumen diameter (mm) along the branch"
    />
  );
}

function BranchName({ node }: { node: BranchNode }) {
  const station = useStation();
  const renaming = useApp((state) => state.ui.renaming === node.branch.id);
  const words = nameText(node);
  if (renaming) return <NameField key={node.branch.id} node={node} />;
  return (
    <header className="branch-name">
      <h3 data-testid="branch-title">{node.label}</h3>
      <Act
        kind="icon"
        icon="pencil"
        words={`Rename ${node.label}`}
        keys={keyOf("rename")}
        onPress={() => station.act("rename")}
      />
      <Act
        kind="icon"
        icon="play"
        words={`Fly to the end of ${node.label}`}
        onPress={() => station.chooseBranch(node.branch.id)}
      />
      {node.longName === null && words === null ? null : (
        <p className="quiet">
          {node.longName === null ? "" : sentence(node.longName)}
          {words === null ? "" : `${node.longName === null ? "" : " \u00b7 "}${words}`}
        </p>
      )}
    </header>
  );
}

/** Render the name of a branch as an editable field: Enter saves the name, Escape restores the previous one. */
function NameField({ node }: { node: BranchNode }) {
  const station = useStation();
  const [text, setText] = useState(node.branch.name ?? "");
  const hint = useId();
  const done = (name: string | null | undefined) => {
    if (name !== undefined && name !== node.branch.name) {
      station.send({ type: "edit_tree", edit: { kind: "rename-branch", branch_id: node.branch.id, name } });
    }
    station.ui({ renaming: null });
    if (document.activeElement instanceof HTMLElement) document.activeElement.blur();
  };
  return (
    <div className="branch-name">
      <TextField
        className="name-field"
        aria-label={`Name of ${node.label}`}
        value={text}
        onChange={setText}
        maxLength={80}
        autoFocus
        onKeyDown={(event) => {
          if (event.key === "Enter" && text.trim() !== "") done(text.trim());
          else if (event.key === "Escape") done(undefined);
          else event.continuePropagation();
        }}
      >
        <Input aria-describedby={hint} spellCheck="false" autoComplete="off" data-testid="branch-name" />
      </TextField>
      <p id={hint} className="quiet small">
        Enter saves the name; Esc cancels.
      </p>
      {node.branch.name_from === "person" ? (
        <Act kind="quiet" label="Automatic name" words="Restore the automatic name" onPress={() => done(null)} />
      ) : null}
    </div>
  );
}
