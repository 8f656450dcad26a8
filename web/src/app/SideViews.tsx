/** The views at the right of the airway view: three slices, the cut-plane, the X-ray and the outside view. */

import { Button } from "react-aria-components";
import { keyOf } from "../input/keymap";
import { fixed } from "../state/format";
import { lettersOf } from "../state/letters";
import { geometryOf, lpsFromPixel, normalOf } from "../state/projection";
import { worksIn } from "../state/tools";
import {
  type FlatView,
  isFlatView,
  nextIn,
  SIDE_CELLS,
  type SideCell,
  showing,
  sideBySideOf,
  viewsOf,
  viewsShownIn,
} from "../state/view-table";
import type { PictureHeader, ViewName } from "../wire/messages";
import { CELLS, VIEWS } from "../wire/views";
import { useApp, useStation } from "./context";
import { Act, Choice, giveKeysBack, SwitchKey, Tip } from "./controls";
import { fitPicture } from "./gestures-flat";
import { PictureMenu } from "./PictureMenu";
import { PictureView } from "./PictureView";
import { ToolTag } from "./ToolTag";
import { useWideWindow } from "./wide-window";

/** Render the views at the right of the airway view. */
export function SideViews() {
  const wide = useWideWindow();
  const shown = useApp((state) => state.ui.shown);
  return (
    <section className="side-views" aria-label="Slices and overviews">
      {SIDE_CELLS.flatMap((cell) =>
        viewsShownIn(cell, shown, wide).map((view, _, { length }) => (
          <Cell key={length === 1 ? cell : view} cell={cell} view={view} isAlone={length === 1} />
        )),
      )}
    </section>
  );
}

/** Value of the button that shows all views of a cell side by side; the other buttons choose one view. */
const SIDE_BY_SIDE = "side-by-side";

/** Render the buttons that switch a cell of the window to another of its views; nothing if the cell has one view. */
function CellTools({ cell, view, isFull }: { cell: SideCell; view: ViewName; isFull: boolean }) {
  const station = useStation();
  const sideBySide = useApp((state) => state.ui.sideBySide);
  const { chosen_by: chosenBy, next_action: action, list_name: name } = CELLS[cell];
  if (chosenBy === "step") {
    const next = VIEWS[nextIn(cell, station.state.ui.shown)];
    return (
      <Act
        kind="icon"
        icon="swap"
        short="Switch"
        words={`Switch to the ${next.words}`}
        keys={keyOf(action)}
        onPress={() => station.act(action)}
      />
    );
  }
  if (chosenBy === "none") return null;
  const set = sideBySideOf(cell);
  const names = set.map((one) => VIEWS[one].short).join(", ");
  const single = viewsOf(cell).map((value) => ({
    value,
    label: VIEWS[value].short,
    words: VIEWS[value].words,
    keys: keyOf(action),
  }));
  // The set needs the space of the full view.
  const together =
    isFull && set.length > 0
      ? [{ value: SIDE_BY_SIDE, label: "Side by side", words: `${names} side by side` } as const]
      : [];
  return (
    <Choice<ViewName | typeof SIDE_BY_SIDE>
      name={name}
      value={isFull && sideBySide ? SIDE_BY_SIDE : view}
      choices={[...single, ...together]}
      onChange={(value) => (value === SIDE_BY_SIDE ? station.ui({ sideBySide: true }) : station.show(value))}
    />
  );
}

/** Return the text for a view without a picture: what it will show and how to get it, or that it is being rendered. */
function emptyText(view: ViewName, there: Readonly<Record<Need, boolean>>): string {
  const { needs, empty } = VIEWS[view];
  return needs.length > 0 && needs.every((need) => there[need]) ? "Rendering this view…" : empty;
}

type Need = (typeof VIEWS)[ViewName]["needs"][number];

interface CellProps {
  cell: SideCell;
  view: ViewName;
  /** Whether the window shows no other view of the cell. */
  isAlone: boolean;
}

/** Render a view with its header; in full view, a cell with a set of views may show all of them side by side. */
function Cell({ cell, view, isAlone }: CellProps) {
  const station = useStation();
  const isFull = useApp((state) => state.ui.full === cell && state.ui.shown[cell] === view);
  const sideBySide = useApp((state) => state.ui.sideBySide);
  const armed = useApp((state) => state.ui.armed);
  const markable = armed === null ? undefined : worksIn(armed, view) ? "yes" : "no";
  const toggleFull = () =>
    station.ui(isFull ? { full: null } : { full: cell, shown: showing(view, station.state.ui.shown) });
  const { title, plane, outlined } = VIEWS[view];
  const set = isFull && sideBySide ? sideBySideOf(cell) : [];
  return (
    <section className="cell" data-cell={cell} data-full={isFull || undefined} data-armed={markable} aria-label={title}>
      <header>
        {plane === null ? null : (
          <span className="plane" style={{ background: `var(--${plane})` }} aria-hidden="true" />
        )}
        <h2>{title}</h2>
        <span className="space" />
        {isAlone || isFull ? <CellTools cell={cell} view={view} isFull={isFull} /> : null}
        {outlined ? <OutlineSwitch /> : null}
        {isFlatView(view) ? <Fit view={view} /> : null}
        <PictureMenu view={view} />
        <Act
          kind="icon"
          icon={isFull ? "leaveFull" : "full"}
          short={isFull ? "Leave full view" : "Full view"}
          words={isFull ? "Leave full view" : "Full view"}
          keys="double-click"
          onPress={toggleFull}
        />
      </header>
      {set.length === 0 ? (
        <CellPicture view={view} onDoubleClick={toggleFull} />
      ) : (
        <div className="cell-set">
          {set.map((one) => (
            <figure key={one}>
              <CellPicture view={one} onDoubleClick={toggleFull} />
              <figcaption>{VIEWS[one].short}</figcaption>
            </figure>
          ))}
        </div>
      )}
      {plane === null ? null : <SliceLine view={view} />}
    </section>
  );
}

/** Render the picture of a view, or the text why there is none. */
function CellPicture({ view, onDoubleClick }: { view: ViewName; onDoubleClick: () => void }) {
  const shown = useApp((state) => state.frames[view] !== undefined);
  const route = useApp((state) => state.route !== null);
  const airways = useApp((state) => state.tree !== null);
  const { title, short } = VIEWS[view];
  return (
    <div className="cell-picture">
      <PictureView
        view={view}
        shape="fill"
        name={short === "" ? title : `${title}, ${short}`}
        onDoubleClick={onDoubleClick}
      />
      {shown ? null : <p className="empty centre">{emptyText(view, { route, airways })}</p>}
      <ToolTag view={view} />
    </div>
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
      short="Outline"
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
      short="Fit"
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
