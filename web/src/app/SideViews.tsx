/** The views at the right of the airway view: three slices, the cut-plane, the X-ray and the outside view. */

import { Button } from "react-aria-components";
import { keyOf } from "../input/keymap";
import { fixed } from "../state/format";
import { lettersOf } from "../state/letters";
import { geometryOf, lpsFromPixel, normalOf } from "../state/projection";
import { worksIn } from "../state/tools";
import { type FlatView, isFlatView, nextIn, SIDE_CELLS, type SideCell, viewsOf } from "../state/view-table";
import type { PictureHeader, ViewName } from "../wire/messages";
import { CELLS, VIEWS } from "../wire/views";
import { useApp, useStation } from "./context";
import { Act, Choice, giveKeysBack, SwitchKey, Tip } from "./controls";
import { fitPicture } from "./gestures-flat";
import { PictureMenu } from "./PictureMenu";
import { PictureView } from "./PictureView";
import { ToolTag } from "./ToolTag";

/** Render the views at the right of the airway view. */
export function SideViews() {
  return (
    <section className="side-views" aria-label="Slices and overviews">
      {SIDE_CELLS.map((cell) => (
        <Cell key={cell} cell={cell} />
      ))}
    </section>
  );
}

/** Render the buttons that switch a cell of the window to another of its views; nothing if the cell has one view. */
function CellTools({ cell, view }: { cell: SideCell; view: ViewName }) {
  const station = useStation();
  const { chosen_by: chosenBy, next_action: action, list_name: name } = CELLS[cell];
  if (chosenBy === "step") {
    const next = VIEWS[nextIn(cell, station.state.ui.shown)];
    return (
      <Act
        kind="icon"
        icon="swap"
        words={`Show the ${next.words} here`}
        keys={keyOf(action)}
        onPress={() => station.act(action)}
      />
    );
  }
  if (chosenBy === "none") return null;
  const choices = viewsOf(cell).map((value) => ({
    value,
    label: VIEWS[value].short,
    words: VIEWS[value].words,
    keys: keyOf(action),
  }));
  return <Choice<ViewName> name={name} value={view} choices={choices} onChange={station.show} />;
}

/** Return the text for a view without a picture: what it will show and how to get it, or that it is being rendered. */
function emptyText(view: ViewName, there: Readonly<Record<Need, boolean>>): string {
  const { needs, empty } = VIEWS[view];
  return needs.length > 0 && needs.every((need) => there[need]) ? "Rendering this view…" : empty;
}

type Need = (typeof VIEWS)[ViewName]["needs"][number];

function Cell({ cell }: { cell: SideCell }) {
  const station = useStation();
  const view = useApp((state) => state.ui.shown[cell]);
  const isFull = useApp((state) => state.ui.full === cell);
  const shown = useApp((state) => state.frames[view] !== undefined);
  const armed = useApp((state) => state.ui.armed);
  const route = useApp((state) => state.route !== null);
  const airways = useApp((state) => state.tree !== null);
  const markable = armed === null ? undefined : worksIn(armed, view) ? "yes" : "no";
  const toggleFull = () => station.ui({ full: station.state.ui.full === cell ? null : cell });
  const { title, plane, outlined } = VIEWS[view];
  return (
    <section className="cell" data-cell={cell} data-full={isFull || undefined} data-armed={markable} aria-label={title}>
      <header>
        {plane === null ? null : (
          <span className="plane" style={{ background: `var(--${plane})` }} aria-hidden="true" />
        )}
        <h2>{title}</h2>
        <span className="space" />
        <CellTools cell={cell} view={view} />
        {outlined ? <OutlineSwitch /> : null}
        {isFlatView(view) ? <Fit view={view} /> : null}
        <PictureMenu view={view} />
        <Act
          kind="icon"
          icon={isFull ? "leaveFull" : "full"}
          words={isFull ? "Leave full view" : "Full view"}
          keys="double-click"
          onPress={toggleFull}
        />
      </header>
      <div className="cell-picture">
        <PictureView view={view} shape="fill" name={title} onDoubleClick={toggleFull} />
        {shown ? null : <p className="empty centre">{emptyText(view, { route, airways })}</p>}
        <ToolTag view={view} />
      </div>
      {plane === null ? null : <SliceLine view={view} />}
    </section>
  );
}

/**
 * Render the line below a slice: its position, and whether the slices follow the tip. The line is outside the picture,
 * where it covers no label.
 */
function SliceLine({ view }: { view: ViewName }) {
  return (
    <footer>
      <SlicePlace view={view} />
      <FollowChip />
    </footer>
  );
}

/**
 * Render whether the slices follow the tip. If the slices show another point, the text is a button that makes the
 * slices follow the tip again.
 */
function FollowChip() {
  const station = useStation();
  const follows = useApp((state) => state.sight.crosshair_lps === null);
  if (follows) {
    return (
      <span className="follow-chip" data-testid="follow-tip">
        following the tip
      </span>
    );
  }
  return (
    <Tip words="Make all slices follow the tip again" keys={keyOf("crosshair_to_tip")}>
      <Button
        className="follow-chip off"
        aria-label="Slices are not following the tip. Follow the tip again."
        data-testid="follow-tip"
        onPress={(event) => {
          giveKeysBack(event.pointerType);
          station.act("crosshair_to_tip");
        }}
      >
        not following the tip
      </Button>
    </Tip>
  );
}

/** Render the switch of the lumen outline in all slices and in the cut-plane. */
function OutlineSwitch() {
  const station = useStation();
  const on = useApp((state) => state.ui.outlineVisible);
  const found = useApp((state) => state.tree !== null);
  if (!found) return null;
  return (
    <SwitchKey
      icon="lumen"
      words="Lumen outline and centrelines (dashed: drawn by hand; dotted: uncertain)"
      keys={keyOf("toggle_outline")}
      on={on}
      testId="outline"
      onChange={() => station.act("toggle_outline")}
    />
  );
}

/** Render the button that resets zoom and pan of a planar view. */
function Fit({ view }: { view: FlatView }) {
  const station = useStation();
  const zoomed = useApp((state) => {
    const place = state.sight.zoom[view];
    return (place?.mm_per_px ?? place?.extent_mm ?? null) !== null;
  });
  if (!zoomed) return null;
  const words = VIEWS[view].zoom === "extent" ? "Centre on the tip, 60 mm wide" : "Fit the whole slice";
  return (
    <Act
      kind="icon"
      icon="fit"
      words={words}
      keys="Home"
      testId={`fit-${view}`}
      onPress={() => fitPicture(station, view)}
    />
  );
}

/** Render the position of a slice along its normal as text: `S 12.1 mm`. */
function SlicePlace({ view }: { view: ViewName }) {
  const words = useApp((state) => placeText(state.frames[view]));
  return words === "" ? null : <span className="numbers quiet">{words}</span>;
}

function placeText(header: PictureHeader | undefined): string {
  if (header === undefined) return "";
  const geometry = geometryOf(header);
  if (geometry === null || geometry.kind !== "flat") return "";
  const middle = lpsFromPixel(geometry, { column: header.width / 2, row: header.height / 2 });
  const normal = normalOf(geometry);
  const axis = Math.abs(normal[2]) > 0.9 ? 2 : Math.abs(normal[1]) > 0.9 ? 1 : Math.abs(normal[0]) > 0.9 ? 0 : null;
  if (axis === null) return "oblique";
  const value = middle[axis];
  const dir = [0, 0, 0];
  dir[axis] = Math.sign(value) || 1;
  return `${lettersOf([dir[0] ?? 0, dir[1] ?? 0, dir[2] ?? 0])} ${fixed(Math.abs(value), 1)} mm`;
}
