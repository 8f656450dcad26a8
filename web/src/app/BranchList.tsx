/**
 * The airway tree as a list. A click on a branch selects the route to the branch; hovering highlights the branch in all
 * views.
 */

import { useEffect, useMemo, useRef, useState } from "react";
import { Button, Input, type Key, SearchField, Tree, TreeItem, TreeItemContent } from "react-aria-components";
import { ClickCounter } from "../input/clicks";
import { keyOf } from "../input/keymap";
import type { BranchNode, BranchTree } from "../state/airways";
import { headOf, lineage, rowChildren } from "../state/airways";
import { shownBranch } from "../state/app-state";
import { bestHit, calibreOf, filterTree, kindText, marksOfRow, tooltipOf } from "../state/branch-text";
import { plural, sentence } from "../state/format";
import { wantsBranch } from "../state/tools";
import { below } from "../state/tree-index";
import { AbsentAirways } from "./AbsentAirways";
import { useApp, useStation } from "./context";
import { Act, Tip } from "./controls";
import { Icon } from "./icons";
import { ListHead } from "./ListHead";
import { movedFocus, wasMouse, wasPointer } from "./last-input";
import { ListToolTag } from "./ToolTag";
import { UncertainPlaces } from "./UncertainPlaces";

/** Number of generations that are expanded when a tree is first shown. */
const OPEN_GENERATIONS = 2;

/** Render the list of branches with its search field, or a text while there are no airways. */
export function BranchList() {
  const station = useStation();
  const tree = useApp((state) => state.tree);
  const words = useApp((state) => emptyText(state.session?.airways, state.session?.airways_words ?? null));
  const failed = useApp((state) => state.session?.airways === "failed");
  const arming = useApp((state) => state.ui.armed === "root");
  const routeEnd = useApp((state) => state.route?.spans.at(-1)?.branch_id ?? null);
  const chosen = rowOf(tree, routeEnd);
  const shown = useApp((state) => rowOf(state.tree, shownBranch(state)));
  /** Whether a click on a row applies the active tool to a branch (cut, smooth, or move its fork). */
  const forTool = useApp((state) => wantsBranch(state.ui.armed, state.ui.forkHeld !== null));
  /**
   * Counter of clicks by cursor position. Rows move up after a cut, and the second click of a double click must not
   * apply the tool to the row that has moved there.
   */
  const clicks = useRef(new ClickCounter());
  const isRepeated = useRef(false);
  const [expanded, setExpanded] = useState<Set<Key>>(new Set());
  const [search, setSearch] = useState("");
  const list = useRef<HTMLDivElement>(null);
  /**
   * The tree for which the rows were expanded. The expansion stays after an edit, and is reset for a tree with another
   * root.
   */
  const known = useRef<BranchTree | null>(null);
  /** Branch to which the list was scrolled last, and the request of the frame in which the list will scroll. */
  const scrolledTo = useRef<number | null>(null);
  const scrolling = useRef(0);
  /** Cancel a pending scroll, because the rows would move away from under the cursor. */
  const cancelScroll = () => cancelAnimationFrame(scrolling.current);

  useEffect(() => {
    const before = known.current;
    known.current = tree;
    if (tree === null || before?.root.branch.id === tree.root.branch.id) return;
    const open = [...tree.byId.values()].filter((node) => node.branch.generation < OPEN_GENERATIONS);
    setExpanded(new Set(open.map((node) => String(node.branch.id))));
  }, [tree]);

  useEffect(() => {
    if (tree === null || shown === null) return;
    const open = lineage(tree, shown)
      .slice(0, -1)
      .map((node) => String(headOf(node).branch.id));
    setExpanded((old) => (open.every((id) => old.has(id)) ? old : new Set([...old, ...open])));
    // An edit of the tree does not scroll the list.
    if (scrolledTo.current === shown) return;
    scrolledTo.current = shown;
    // Wait for the next frame, so that the row has been rendered before the list scrolls to it.
    cancelAnimationFrame(scrolling.current);
    scrolling.current = requestAnimationFrame(() => list.current !== null && bringIntoList(list.current, shown));
  }, [tree, shown]);

  const filtered = useMemo(() => (tree === null ? null : filterTree(tree, search)), [tree, search]);
  const rows = useMemo(
    () => (tree === null ? null : <Row node={tree.root} only={filtered?.shown ?? null} />),
    [tree, filtered],
  );
  if (tree === null) {
    return (
      <section className="branches" aria-label="List of branches">
        <ListHead />
        <p className="empty">{sentence(words)}</p>
        {failed ? (
          <div className="mend">
            <Act
              icon="target"
              label={arming ? "Click in a view\u2026" : "Mark the trachea"}
              words="Click inside the trachea in any view to segment the airways"
              keys={keyOf("arm_root")}
              onPress={() => station.act("arm_root")}
            />
          </div>
        ) : null}
      </section>
    );
  }
  /** Choose the route to the far end of the bronchus that a row lists, past its side branches. */
  const chooseRow = (id: number) => {
    const last = lastPiece(tree, id);
    if (last === routeEnd) station.ui({ selected: last });
    else station.chooseBranch(last);
    giveKeysBackAfterClick();
  };
  /** Row that Enter would choose; null if there is no such row. */
  const hit = filtered === null || forTool ? null : bestHit(tree, filtered, search);
  /** Choose the best match of the search, and return the keys to the flight. */
  const chooseHit = () => {
    if (hit === null) return;
    chooseRow(hit);
    if (document.activeElement instanceof HTMLElement) document.activeElement.blur();
  };
  const count =
    filtered === null ? plural(tree.byId.size, "branch", "branches") : plural(filtered.hits.length, "match", "matches");
  return (
    <section className="branches" aria-label="List of branches">
      <ListHead>
        <ListToolTag /> <span className="quiet numbers">{count}</span>
      </ListHead>
      <BranchSearch value={search} onChange={setSearch} onSubmit={chooseHit} />
      <RowStyles tree={tree} hit={hit} />
      {filtered !== null && filtered.hits.length === 0 ? (
        <p className="empty">
          No branch matches. Try a segment (RB9), a lobe, a generation (g3), or {"\u201c?\u201d"} for uncertain names.
        </p>
      ) : (
        // biome-ignore lint/a11y/noStaticElementInteractions: hover or focus of a row highlights its branch; the tree inside is interactive
        <div
          ref={list}
          className="branch-rows"
          data-armed={forTool || undefined}
          onPointerDownCapture={({ clientX, clientY, timeStamp, pointerType }) => {
            cancelScroll();
            const by = pointerType === "mouse" ? "mouse" : "finger";
            isRepeated.current = clicks.current.count({ x: clientX, y: clientY }, timeStamp, by) > 1;
          }}
          onKeyDownCapture={() => {
            isRepeated.current = false;
          }}
          onPointerMove={(event) => {
            cancelScroll();
            station.pointing.hoverBranch(branchOf(event.target));
          }}
          onPointerLeave={() => station.pointing.hoverBranch(null)}
          onFocus={(event) => station.pointing.hoverBranch(branchOf(event.target))}
          onBlur={() => station.pointing.hoverBranch(null)}
        >
          <Tree
            aria-label={forTool ? "Airway branches: choose the one to edit" : "Airway branches: choose one to fly to"}
            className="branch-tree"
            selectionMode={forTool ? "none" : "single"}
            onAction={(key) => {
              if (!forTool) {
                // Enter and a tap are actions. The first click of a double click has already chosen the branch.
                if (!wasMouse()) chooseRow(Number(key));
                return;
              }
              if (!isRepeated.current) station.pointing.clickRow(Number(key));
              giveKeysBackAfterClick();
            }}
            selectionBehavior="replace"
            selectedKeys={chosen === null ? [] : [String(chosen)]}
            onSelectionChange={(keys) => {
              const [key] = [...keys];
              // Tab and the arrow keys move the focus and choose no route.
              if (key !== undefined && !movedFocus()) chooseRow(Number(key));
            }}
            expandedKeys={filtered === null ? expanded : new Set([...filtered.shown].map(String))}
            onExpandedChange={setExpanded}
          >
            {rows}
          </Tree>
        </div>
      )}
      <AbsentAirways />
      <UncertainPlaces />
    </section>
  );
}

interface BranchSearchProps {
  value: string;
  onChange: (text: string) => void;
  onSubmit: () => void;
}

function BranchSearch({ value, onChange, onSubmit }: BranchSearchProps) {
  return (
    <SearchField
      className="branch-filter"
      aria-label="Search branches"
      value={value}
      onChange={onChange}
      onSubmit={onSubmit}
      onKeyDown={(event) => {
        // Escape in an empty field returns the keyboard focus to the flight.
        if (event.key === "Escape" && value === "" && document.activeElement instanceof HTMLElement) {
          document.activeElement.blur();
        } else event.continuePropagation();
      }}
    >
      <Icon name="search" />
      <Tip
        words="Search: name, lobe, g3 = generation 3, ? = uncertain. Enter chooses the exact name, else the first match."
        keys={keyOf("find_branch")}
      >
        <Input placeholder="Search, e.g. RB1 or g3" spellCheck="false" autoComplete="off" />
      </Tip>
      {value === "" ? null : (
        <Button className="clear" aria-label="Clear the search">
          <Icon name="close" />
        </Button>
      )}
    </SearchField>
  );
}

/**
 * Render style rules that highlight the branches of the tip, the cursor, the panel and the search; without them hundreds of rows
 * would render again.
 */
function RowStyles({ tree, hit }: { tree: BranchTree; hit: number | null }) {
  const here = useApp((state) => rowOf(tree, state.pose?.branch_id ?? null));
  const pointed = useApp((state) => state.ui.hovered?.branchId ?? null);
  const hovered = rowOf(tree, pointed);
  const selected = useApp((state) => rowOf(tree, state.ui.selected));
  const cuts = useApp((state) => state.ui.armed === "cut");
  const rules: string[] = [];
  const doomed = pointed === null || !cuts ? undefined : tree.byId.get(pointed);
  if (doomed !== undefined) {
    const rows = below(doomed).map(({ branch }) => `[data-branch="${branch.id}"]`);
    rules.push(`.branch-tree :is(${rows.join()}) { color: var(--warning); }`);
  }
  if (here !== null && tree.byId.has(here)) {
    rules.push(`.branch-tree [data-branch="${here}"] .here { visibility: visible; }`);
  }
  if (hovered !== null) {
    rules.push(`.branch-tree .react-aria-TreeItem:has([data-branch="${hovered}"]) { background: var(--hover); }`);
  }
  if (selected !== null) {
    rules.push(
      `.branch-tree .react-aria-TreeItem:has([data-branch="${selected}"]) { box-shadow: inset 2px 0 var(--accent); }`,
    );
  }
  if (hit !== null) {
    rules.push(
      `.branch-tree .react-aria-TreeItem:has([data-branch="${hit}"]) { outline: 1px dashed var(--accent); outline-offset: -1px; }`,
    );
  }
  return rules.length === 0 ? null : <style>{rules.join("\n")}</style>;
}

/** Scroll the list to the row of a branch without scrolling the page, which must not move on a tablet. */
function bringIntoList(list: HTMLElement, branchId: number): void {
  const row = list.querySelector(`[data-branch="${branchId}"]`)?.getBoundingClientRect();
  const box = list.querySelector(".branch-tree");
  if (row === undefined || box === null) return;
  const { top, bottom } = box.getBoundingClientRect();
  if (row.top < top) box.scrollTop -= top - row.top;
  // Scroll by whole rows, so that no row is cut off at the top.
  else if (row.bottom > bottom)
    box.scrollTop = Math.ceil((box.scrollTop + row.bottom - bottom) / row.height) * row.height;
}

function branchOf(target: EventTarget): number | null {
  if (!(target instanceof HTMLElement)) return null;
  const row = target.closest('[role="row"]')?.querySelector("[data-branch]") ?? target.closest("[data-branch]");
  const id = row instanceof HTMLElement ? row.dataset.branch : undefined;
  return id === undefined ? null : Number(id);
}

/**
 * Remove the focus from the list after a click, so that the keys move the tip again. A user who moves through the list
 * by keys keeps the focus in the list.
 */
function giveKeysBackAfterClick(): void {
  if (!wasPointer()) return;
  requestAnimationFrame(() => {
    if (document.activeElement instanceof HTMLElement) document.activeElement.blur();
  });
}

function Row({ node, only }: { node: BranchNode; only: ReadonlySet<number> | null }) {
  const { branch } = node;
  const kind = kindText(branch.kind);
  const lumen = calibreOf(node);
  const onward = rowChildren(node);
  const children = only === null ? onward : onward.filter((child) => only.has(child.branch.id));
  return (
    <TreeItem id={String(branch.id)} textValue={node.label}>
      <TreeItemContent>
        {({ hasChildItems }) => (
          <div className="branch" data-branch={branch.id} title={tooltipOf(node)}>
            {hasChildItems ? (
              <Button slot="chevron" className="chevron" aria-label={`Branches of ${node.label}`}>
                <Icon name="chevron" />
              </Button>
            ) : (
              <span className="chevron" />
            )}
            <span className={`side ${node.side}${kind === null ? "" : " drawn"}`} data-lobe={node.lobe ?? undefined} />
            <span className="name">
              {node.label}
              {marksOfRow(node).map((mark) => (
                <abbr key={mark.words} className="mark" title={mark.words}>
                  {mark.sign}
                </abbr>
              ))}
            </span>
            {kind === null ? null : <em className="kind">{kind}</em>}
            <span className="here" aria-hidden="true">
              {"\u25c0"}
            </span>
            <span className="numbers generation" title="generation">
              g{branch.generation}
            </span>
            {lumen === null ? null : (
              <span className="numbers quiet lumen" title="lumen, mm">
                {lumen}
              </span>
            )}
          </div>
        )}
      </TreeItemContent>
      {children.map((child) => (
        <Row key={child.branch.id} node={child} only={only} />
      ))}
    </TreeItem>
  );
}

/**
 * Return the ID of the first branch in a branch's row, which represents the row in the list; null if the branch does
 * not exist.
 */
function rowOf(tree: BranchTree | null, id: number | null): number | null {
  const node = id === null ? undefined : tree?.byId.get(id);
  return node === undefined ? null : headOf(node).branch.id;
}

const lastPiece = (tree: BranchTree, id: number): number => tree.byId.get(id)?.row.at(-1)?.branch.id ?? id;

function emptyText(airways: string | undefined, words: string | null): string {
  switch (airways) {
    case "finding":
      return "Segmenting the airways. Their branches will be listed here. You can fly freely in the meantime.";
    case "failed":
      return words ?? "No airways were found. Mark the trachea under \u201cAirways\u201d.";
    default:
      return words ?? "The airway branches will be listed here once they have been segmented.";
  }
}
