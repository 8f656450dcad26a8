/** The airway tree as a list. A branch that is chosen becomes the route. */

import { useEffect, useMemo, useState } from "react";
import { Button, type Key, Tree, TreeItem, TreeItemContent } from "react-aria-components";
import { keyOf } from "../input/keymap";
import { type BranchNode, type BranchTree, lineage } from "../state/airways";
import { fixed, sentence } from "../state/format";
import { useApp, useStation } from "./context";
import { Act } from "./controls";
import { Icon } from "./icons";

/** Open at first: as far as every bronchoscopist knows the names by heart. */
const OPEN_GENERATIONS = 2;

export function BranchList() {
  const station = useStation();
  const tree = useApp((state) => state.tree);
  const words = useApp((state) => emptyWords(state.session?.airways, state.session?.airways_words ?? null));
  const failed = useApp((state) => state.session?.airways === "failed");
  const arming = useApp((state) => state.ui.armed === "root");
  const chosen = useApp((state) => routeEnd(state.route?.spans ?? null));
  const here = useApp((state) => state.pose?.branch_id ?? null);
  const [expanded, setExpanded] = useState<Set<Key>>(new Set());

  useEffect(() => {
    if (tree === null) return;
    const open = [...tree.byId.values()].filter((node) => node.branch.generation < OPEN_GENERATIONS);
    setExpanded(new Set(open.map((node) => String(node.branch.id))));
  }, [tree]);

  useEffect(() => {
    if (tree === null || chosen === null) return;
    const open = lineage(tree, chosen)
      .slice(0, -1)
      .map((node) => String(node.branch.id));
    setExpanded((old) => (open.every((id) => old.has(id)) ? old : new Set([...old, ...open])));
  }, [tree, chosen]);

  const rows = useMemo(() => (tree === null ? null : <Row node={tree.root} />), [tree]);
  if (tree === null) {
    return (
      <section className="branches" aria-label="Airways">
        <h2>Airways</h2>
        <p className="empty">{sentence(words)}</p>
        {failed ? (
          <div className="mend">
            <Act
              icon="target"
              label={arming ? "Click in a slice\u2026" : "Set the root"}
              words="The next click in a slice begins the airways there"
              keys={keyOf("arm_root")}
              onPress={() => station.act("arm_root")}
            />
          </div>
        ) : null}
      </section>
    );
  }
  return (
    <section className="branches" aria-label="Airways">
      <h2>
        Airways <span className="quiet numbers">{tree.byId.size} branches</span>
      </h2>
      <HereStyle tree={tree} here={here} />
      <Tree
        aria-label="Airway branches; choosing one makes it the route"
        className="branch-tree"
        selectionMode="single"
        selectionBehavior="replace"
        selectedKeys={chosen === null ? [] : [String(chosen)]}
        onSelectionChange={(keys) => {
          const [key] = [...keys];
          if (key !== undefined && Number(key) !== chosen) station.chooseBranch(Number(key));
          giveKeysBackAfterClick();
        }}
        expandedKeys={expanded}
        onExpandedChange={setExpanded}
      >
        {rows}
      </Tree>
    </section>
  );
}

/** Marks the branch that the tip is in without rendering hundreds of rows again for each step of the flight. */
function HereStyle({ tree, here }: { tree: BranchTree; here: number | null }) {
  if (here === null || !tree.byId.has(here)) return null;
  return <style>{`.branch-tree [data-branch="${here}"] .here { visibility: visible; }`}</style>;
}

let lastInput: "pointer" | "key" = "pointer";
if (typeof window !== "undefined") {
  window.addEventListener("pointerdown", () => (lastInput = "pointer"), { capture: true });
  window.addEventListener("keydown", () => (lastInput = "key"), { capture: true });
}

/** After a click the arrows fly again; who moves through the list by keys keeps them in the list. */
function giveKeysBackAfterClick(): void {
  if (lastInput !== "pointer") return;
  requestAnimationFrame(() => {
    if (document.activeElement instanceof HTMLElement) document.activeElement.blur();
  });
}

function Row({ node }: { node: BranchNode }) {
  const { branch } = node;
  const about = [
    `generation ${branch.generation}`,
    `${fixed(node.lengthMm)} mm long`,
    `${fixed(node.diameterMm, 1)} mm wide`,
  ].join(", ");
  return (
    <TreeItem id={String(branch.id)} textValue={node.label}>
      <TreeItemContent>
        {({ hasChildItems }) => (
          <div className="branch" data-branch={branch.id} title={`${node.label}: ${about}`}>
            {hasChildItems ? (
              <Button slot="chevron" className="chevron" aria-label={`Branches of ${node.label}`}>
                <Icon name="chevron" />
              </Button>
            ) : (
              <span className="chevron" />
            )}
            <span className={`side ${node.side}`} />
            <span className="name">
              {node.label}
              {branch.kind === "tracked" ? null : <em className="kind"> {branch.kind}</em>}
            </span>
            <span className="here" aria-hidden="true">
              {"\u25c0"}
            </span>
            <span className="numbers quiet">{fixed(node.diameterMm, 1)}</span>
          </div>
        )}
      </TreeItemContent>
      {node.children.map((child) => (
        <Row key={child.branch.id} node={child} />
      ))}
    </TreeItem>
  );
}

function routeEnd(spans: readonly { branch_id: number }[] | null): number | null {
  return spans?.at(-1)?.branch_id ?? null;
}

function emptyWords(airways: string | undefined, words: string | null): string {
  switch (airways) {
    case "finding":
      return "The airways are being found. Their branches will be listed here; you can fly freely meanwhile.";
    case "failed":
      return words ?? "No airways were found. Mark a root inside the trachea under \u201cAirways\u201d.";
    default:
      return words ?? "The branches of the airways will be listed here once they are found.";
  }
}
