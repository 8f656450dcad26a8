/** The pictures at the right: three slices, the cut-plane, the X-ray and the view from outside. */

import type { ReactNode } from "react";
import { keyOf } from "../input/keymap";
import type { CellName, XrayView } from "../state/app-state";
import { fixed } from "../state/format";
import { lettersOf } from "../state/letters";
import { geometryOf, lpsFromPixel, normalOf } from "../state/projection";
import { worksIn } from "../state/tools";
import type { PictureHeader, ViewName } from "../wire/messages";
import { useApp, useStation } from "./context";
import { Act, Choice, SwitchKey } from "./controls";
import { type FlatView, fitPicture, isFlatView } from "./gestures-flat";
import { PictureView } from "./PictureView";
import { ToolTag } from "./ToolTag";

const SLICES = [
  { cell: "axial", title: "Axial" },
  { cell: "coronal", title: "Coronal" },
  { cell: "sagittal", title: "Sagittal" },
] as const;

const CUTS = {
  "cut-plane": { title: "Cut-plane", next: "straightened airway" },
  straightened: { title: "Straightened", next: "curved reformation" },
  curved: { title: "Curved", next: "cut-plane" },
} as const;

export function SideViews() {
  const station = useStation();
  const xray = useApp((state) => state.ui.xray);
  const cut = useApp((state) => state.ui.cut);
  const outside = useApp((state) => state.ui.outside);
  const hasRoute = useApp((state) => state.route !== null);
  const hasTree = useApp((state) => state.tree !== null);
  return (
    <section className="side-views" aria-label="Slices and overviews">
      {SLICES.map(({ cell, title }) => (
        <Cell
          key={cell}
          cell={cell}
          view={cell}
          title={title}
          reading={<SlicePlace view={cell} />}
          empty={`The ${cell} slice through the tip appears here when a CT is open.`}
        />
      ))}
      <Cell
        cell="cut-plane"
        view={cut}
        title={CUTS[cut].title}
        tools={
          <Act
            kind="icon"
            icon="swap"
            words={`Show the ${CUTS[cut].next} here`}
            keys={keyOf("next_cut")}
            onPress={() => station.act("next_cut")}
          />
        }
        empty={
          cut === "cut-plane"
            ? "The plane across the tip, at right angles to the scope, appears here when a CT is open."
            : hasRoute
              ? "This picture is on its way."
              : "There is no route yet. Choose a branch in the list, or mark a target: the airway along the way there appears here."
        }
      />
      <Cell
        cell="xray"
        view={xray}
        title="X-ray"
        tools={
          <Choice<XrayView>
            name="Direction of the X-ray"
            value={xray}
            choices={[
              { value: "xray-coronal", label: "AP", words: "X-ray from the front", keys: keyOf("next_xray") },
              { value: "xray-sagittal", label: "Lat", words: "X-ray from the side", keys: keyOf("next_xray") },
              { value: "xray-axial", label: "Ax", words: "X-ray from below", keys: keyOf("next_xray") },
              {
                value: "drr",
                label: "DRR",
                words: "Radiograph from the C-arm: drag to turn it",
                keys: keyOf("next_xray"),
              },
            ]}
            onChange={(value) => station.ui({ xray: value })}
          />
        }
        empty="The X-ray view with the tip in it appears here when a CT is open."
      />
      <Cell
        cell="outside"
        view={outside}
        title={outside === "tree" ? "Airway tree" : "Tri-plane"}
        tools={
          <Act
            kind="icon"
            icon="swap"
            words={outside === "tree" ? "Show the tri-plane here" : "Show the airway tree here"}
            keys={keyOf("swap_outside")}
            onPress={() => station.act("swap_outside")}
          />
        }
        empty={
          outside === "tree" && !hasTree
            ? "The airway tree from outside appears here once the airways are found."
            : "This picture is on its way."
        }
      />
    </section>
  );
}

interface CellProps {
  cell: CellName;
  view: ViewName;
  title: string;
  reading?: ReactNode;
  tools?: ReactNode;
  empty: string;
}

function Cell({ cell, view, title, reading, tools, empty }: CellProps) {
  const station = useStation();
  const isFull = useApp((state) => state.ui.full === cell);
  const shown = useApp((state) => state.frames[view] !== undefined);
  const armed = useApp((state) => state.ui.armed);
  const markable = armed === null ? undefined : worksIn(armed, view) ? "yes" : "no";
  const toggleFull = () => station.ui({ full: station.state.ui.full === cell ? null : cell });
  return (
    <section className="cell" data-cell={cell} data-armed={markable} aria-label={title}>
      <header>
        <span className={`plane ${cell}`} aria-hidden="true" />
        <h2>{title}</h2>
        {reading}
        <span className="space" />
        {tools}
        {isFlatView(view) ? <OutlineSwitch /> : null}
        {isFlatView(view) ? <Fit view={view} /> : null}
        <Act
          kind="icon"
          icon={isFull ? "leaveFull" : "full"}
          words={isFull ? "Back to all pictures" : "Full view"}
          keys="double click"
          onPress={toggleFull}
        />
      </header>
      <div className="cell-picture">
        <PictureView view={view} shape="fill" name={title} onDoubleClick={toggleFull} />
        {shown ? null : <p className="empty centre">{empty}</p>}
        <ToolTag view={view} />
      </div>
    </section>
  );
}

/** What was found, over the CT: in all slices and the cut-plane at once. */
function OutlineSwitch() {
  const station = useStation();
  const on = useApp((state) => state.ui.outlineVisible);
  const found = useApp((state) => state.tree !== null);
  if (!found) return null;
  return (
    <SwitchKey
      icon="lumen"
      words="Outline of the lumen and centrelines (dashed: drawn by hand; dotted: uncertain)"
      keys={keyOf("toggle_outline")}
      on={on}
      testId="outline"
      onChange={() => station.act("toggle_outline")}
    />
  );
}

/** Brings a zoomed or panned picture back. */
function Fit({ view }: { view: FlatView }) {
  const station = useStation();
  const zoomed = useApp((state) => {
    const zoom = state.session?.zoom;
    if (zoom === undefined) return false;
    return (view === "cut-plane" ? zoom.cut_plane_extent_mm : zoom[`${view}_mm_per_px`]) !== null;
  });
  if (!zoomed) return null;
  const words = view === "cut-plane" ? "Back to the tip, 60 mm wide" : "Fit the whole slice";
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

/** Where a slice lies along its own normal: `S 12.1 mm`. */
function SlicePlace({ view }: { view: ViewName }) {
  const words = useApp((state) => placeWords(state.frames[view]));
  return words === "" ? null : <span className="numbers quiet">{words}</span>;
}

function placeWords(header: PictureHeader | undefined): string {
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
