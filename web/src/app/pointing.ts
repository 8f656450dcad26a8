/**
 * Interpretation of the cursor and of clicks in a view. A position in a picture becomes a branch, a point in the lumen
 * or a brush stroke; a click applies the active tool, or selects.
 */

import { DelayedAction } from "../input/clicks";
import type { PointerPlace } from "../input/pointer";
import { type AppState, crosshairLps, penPoint } from "../state/app-state";
import { previewTool } from "../state/edit-preview";
import { forkOf } from "../state/fork-choice";
import { linesOf, lpsAt } from "../state/lines";
import { LivePathQueue, type LiveQuestion } from "../state/live-path";
import { geometryOf, lpsFromPixel, type PixelPoint } from "../state/projection";
import { isMarkAt, marksStructure, RESTS_MS } from "../state/target-mark";
import { isBrush, isLesionBrush, strokePoints, textsOf, wantsBranch, wantsPath, worksIn } from "../state/tools";
import { trainingLayout } from "../state/training";
import { branchAhead, placeFromOutside, placeInLumen, type TreePlace } from "../state/tree-index";
import { planeUnder } from "../state/tri-plane";
import { asVec3, distance, type Vec3 } from "../state/vec";
import { isOrbitView } from "../state/view-table";
import { isInside } from "../views/outline";
import type { Viewport } from "../views/viewport";
import type { EditTreeMessage, LivePathMessage, PictureHeader, ViewName } from "../wire/messages";
import { VIEWS } from "../wire/views";
import { wasFinger } from "./last-input";
import type { Previewing } from "./previewing";
import type { Station } from "./station";

/** Branch and point (LPS mm) of the patient that a picture shows at a position. */
interface Pointed {
  /**
   * Patient point at the position, LPS mm; null in the airway view, where only the server can compute the wall point.
   */
  readonly lps: Vec3 | null;
  readonly branchId: number | null;
  readonly place: TreePlace | null;
  /** Position in the airway picture, picture px; null in other views. */
  readonly pixel: PixelPoint | null;
}

/** Time, ms, without cursor movement after which the live path leads to the tracked pen instead of the cursor. */
const CURSOR_RESTS_MS = 1000;
/** Maximum distance, CSS px, between the last cursor position and a click for which the click uses that position. */
const SHAKES_PX = 3;
/** Ratio of the maximum distances from a branch at which a finger and a mouse select the branch. */
const FINGER_REACH = 3;

/**
 * Distance of two points under the cursor, mm, below which a new picture shows the same voxel there; a picture of
 * another resolution rounds the point.
 */
const SAME_POINT_MM = 0.02;

/** Handler of the cursor and of clicks in all views. */
export class Pointing {
  readonly #station: Station;
  readonly #previewing: Previewing;
  readonly #live: LivePathQueue;
  /**
   * Identifier of the path request whose answer applies the tool; null if no click in the airway view waits for an
   * answer.
   */
  #commitOn: number | null = null;
  #lastRequestId = 0;
  /** Last position of the cursor, with its view; null if the cursor is outside all views. */
  #hovered: { viewport: Viewport; at: PointerPlace } | null = null;
  #cursorMovedMs = Number.NEGATIVE_INFINITY;
  /** Timer that runs while the cursor rests, before the structure under the cursor is segmented. */
  #resting: ReturnType<typeof setTimeout> | null = null;
  #numMarks = 0;
  /** Pen position of the last path request to the pen, LPS mm. */
  #penRequested: Vec3 | null = null;
  /**
   * Action of a first click that cannot be undone (a new route or a flight). It is delayed until no second click can
   * follow.
   */
  readonly #delayed = new DelayedAction();
  /**
   * Crosshair, wall points and selection before a click, which are restored if a second click makes it a double click.
   */
  #before: { crosshair: Vec3 | null; picks: AppState["picks"]; selected: number | null } | null = null;

  constructor(station: Station, previewing: Previewing) {
    this.#station = station;
    this.#previewing = previewing;
    this.#live = new LivePathQueue(
      (message) => {
        this.#lastRequestId = message.request_id;
        return station.send(message);
      },
      () => performance.now(),
    );
  }

  /** Handle cursor movement in a view; null means that the cursor has left the view. */
  hover(viewport: Viewport, at: PointerPlace | null): void {
    const station = this.#station;
    const { ui } = station.state;
    const pointed = at === null ? null : this.#under(viewport, at);
    const cursor = at === null ? null : { view: viewport.view, x: at.x, y: at.y };
    const hovered = pointed?.branchId == null ? null : { branchId: pointed.branchId, place: pointed.place };
    this.#cursorMovedMs = performance.now();
    this.#hovered = at === null ? null : { viewport, at };
    if (at === null) this.#penRequested = null;
    if (ui.penLeads) station.ui({ penLeads: false });
    if (cursor !== null || ui.cursor?.view === viewport.view || ui.cursor === null) {
      station.ui({ cursor, hovered, pointedLps: pointed?.lps ?? null });
    }
    this.#request(pointed === null ? null : questionOf(viewport.header, pointed));
    this.#markAt(pointed?.lps ?? null);
  }

  /** Request what a click would mark at a point once the cursor has rested there; null ends the wait. */
  #markAt(lps: Vec3 | null): void {
    const station = this.#station;
    if (this.#resting !== null) clearTimeout(this.#resting);
    this.#resting = null;
    if (lps === null || !marksStructure(station.state) || isMarkAt(station.state.targetMark, lps)) return;
    this.#resting = setTimeout(() => {
      this.#resting = null;
      this.#numMarks += 1;
      if (marksStructure(station.state)) station.send({ type: "target_mark", request_id: this.#numMarks, lps });
    }, RESTS_MS);
  }

  /** Update the point under a resting cursor, and its value, after a new picture of its view was drawn. */
  pictureDrawn(view: string): void {
    if (this.#hovered?.viewport.view !== view) return;
    this.#probe(this.#hovered.viewport, this.#hovered.at);
    if (this.#station.state.ui.penLeads) return;
    const { armed, forkHeld, pathCost } = this.#station.state.ui;
    if (!wantsPath(armed, pathCost) && previewTool(armed, forkHeld !== null) === null) return;
    const { viewport, at } = this.#hovered;
    const pointed = this.#under(viewport, at);
    this.#station.ui({ pointedLps: pointed?.lps ?? null });
    this.#request(pointed === null ? null : questionOf(viewport.header, pointed));
    this.#markAt(pointed?.lps ?? null);
  }

  /** Store the cursor position during a drag, and request the value there. */
  dragged(viewport: Viewport, at: PointerPlace): void {
    if (this.#hovered === null) return;
    this.#hovered = { viewport, at };
    this.#probe(viewport, at);
  }

  /** Request the value of the voxel under the cursor; a new picture may show another voxel there. */
  #probe(viewport: Viewport, at: PointerPlace): void {
    const lps = flatPoint(viewport, at);
    const shown = this.#station.state.ui.cursorLps;
    if (lps === null || (shown !== null && distance(lps, shown) < SAME_POINT_MM)) return;
    this.#station.ui({ cursorLps: lps });
    this.#station.sendSoon({ type: "probe", lps });
  }

  /**
   * Return the last cursor position instead of the click position if both are close, because the preview was shown for
   * the cursor position. Browsers report fractional positions for movements but whole pixels for clicks, and the hand
   * may shake.
   */
  #clickPosition(viewport: Viewport, at: PointerPlace): PointerPlace {
    const last = this.#hovered;
    const near = last !== null && Math.max(Math.abs(last.at.x - at.x), Math.abs(last.at.y - at.y)) <= SHAKES_PX;
    return last !== null && near && last.viewport === viewport ? last.at : at;
  }

  /** Highlight the branch of a list row under the cursor; null if the cursor has left the rows. */
  hoverBranch(branchId: number | null): void {
    const { hovered } = this.#station.state.ui;
    if (hovered?.branchId === branchId || (hovered === null && branchId === null)) return;
    this.#station.ui({ cursor: null, hovered: branchId === null ? null : { branchId, place: null } });
  }

  /** Clear the path, the preview and the brush stroke, because the cursor has left or another tool is active. */
  forget(): void {
    this.#forget();
    this.#commitOn = null;
    this.#penRequested = null;
    this.#station.ui({ stroke: [], penLeads: false });
  }

  /**
   * Request what the active tool shows at a point: the path to the point, or the preview of an edit. Null clears both.
   */
  #request(question: LiveQuestion | null): void {
    const { ui, doubt } = this.#station.state;
    const tool = previewTool(ui.armed, ui.forkHeld !== null);
    if (question === null) {
      if (wantsPath(ui.armed, ui.pathCost) || tool !== null) this.#forget();
    } else if (wantsPath(ui.armed, ui.pathCost)) this.#live.request(question);
    else if (tool !== null && doubt === null) {
      this.#previewing.request({ tool, branch_id: tool === "move-fork" ? ui.forkHeld : null, ...question });
    }
  }

  #forget(): void {
    this.#previewing.forget();
    this.#live.forget();
    this.#station.store.dispatch({ kind: "live_path", livePath: null });
  }

  reset(): void {
    this.#live.reset();
    this.#commitOn = null;
  }

  receive(answer: LivePathMessage): void {
    const fresh = this.#live.receive(answer);
    if (this.#commitOn === answer.request_id) {
      this.#commitOn = null;
      if (answer.lps === null) this.#station.notice(answer.problem ?? "No airway here.");
      else this.commit(asVec3(answer.lps));
      return;
    }
    if (fresh !== null) this.#station.store.dispatch({ kind: "live_path", livePath: fresh });
  }

  /** Handle a click; return true if a tool was applied or a branch was selected in an outside view. */
  click(viewport: Viewport, clicked: PointerPlace): boolean {
    const station = this.#station;
    const { armed, forkHeld } = station.state.ui;
    const at = this.#clickPosition(viewport, clicked);
    const pointed = this.#under(viewport, at);
    if (armed !== null && !worksIn(armed, viewport.view)) {
      const { label, hint } = textsOf(armed, false);
      station.notice(`\u201c${label}\u201d does not work in this view. ${hint}`);
      return true;
    }
    if (armed === null) {
      // During an attempt a click must neither change the route nor show the name of a branch.
      if (pointed?.branchId == null || trainingLayout(station.state) !== undefined) return false;
      const { branchId } = pointed;
      if (VIEWS[viewport.view].pick !== "branch") {
        station.ui({ selected: branchId });
        return false;
      }
      station.ui({ selected: branchId });
      this.unlessDouble(() => station.chooseBranch(branchId));
      return true;
    }
    if (pointed === null) return isOrbitView(viewport.view);
    if (isBrush(armed)) {
      this.stroke(viewport, at);
      this.endStroke();
    } else if (wantsBranch(armed, forkHeld !== null)) this.#onBranch(pointed.branchId, pointed.place);
    else if (pointed.lps !== null) this.commit(pointed.lps);
    else if (pointed.pixel !== null && viewport.header !== null) this.commitInPicture(viewport.header, pointed.pixel);
    return true;
  }

  /**
   * Store the state before a click without a tool, which is restored if the click becomes the first half of a double
   * click.
   */
  beginClick(): void {
    const { state } = this.#station;
    this.#delayed.renew();
    this.#before = { crosshair: crosshairLps(state), picks: state.picks, selected: state.ui.selected };
  }

  /** Run an action after the time for a second click has passed; a double click cancels the action. */
  unlessDouble(action: () => void): void {
    this.#delayed.begin(action);
  }

  /** Restore the state before the first click of a double click; return false if the delayed action has already run. */
  undoFirstClick(): boolean {
    const before = this.#before;
    this.#before = null;
    if (!this.#delayed.cancel() || before === null) return false;
    this.#station.restoreBeforeClick(before);
    return true;
  }

  /**
   * Apply the active tool at a pixel of the airway view. The tool is applied when the server has returned the point in
   * the lumen in front of the wall at that pixel.
   */
  commitInPicture(header: PictureHeader, pixel: PixelPoint): void {
    this.#live.reset();
    this.#live.request({ lps: null, frame_id: header.frame_id, column: pixel.column, row: pixel.row });
    this.#commitOn = this.#lastRequestId;
  }

  /** Request the path to the point that the pen's button marks, if the active tool shows paths and the cursor rests. */
  penAt(): void {
    const { state } = this.#station;
    const at = penPoint(state);
    if (at === null || !wantsPath(state.ui.armed, state.ui.pathCost)) return;
    if (performance.now() - this.#cursorMovedMs < CURSOR_RESTS_MS) return;
    if (this.#penRequested !== null && distance(at, this.#penRequested) < 0.1) return;
    this.#penRequested = at;
    this.#station.ui({ penLeads: true });
    this.#request({ lps: at, frame_id: null, column: null, row: null });
  }

  /**
   * Apply the active tool at a patient point without a click: to the branch that contains the point, or to the point
   * itself.
   */
  commitHere(lps: Vec3): void {
    const { tree, ui } = this.#station.state;
    if (!wantsBranch(ui.armed, ui.forkHeld !== null)) {
      this.commit(lps);
      return;
    }
    const place = tree === null ? null : placeInLumen(tree.index, lps);
    this.#onBranch(place?.branchId ?? null, place);
  }

  /** Apply the active tool at a patient point; branch tools and brushes do nothing. */
  commit(lps: Vec3): void {
    const station = this.#station;
    const { armed, forkHeld } = station.state.ui;
    switch (armed) {
      case "target":
        station.addTarget(lps);
        station.disarm();
        break;
      case "start":
        station.disarm();
        station.ui({ pathStart: lps });
        break;
      case "root":
        station.send({ type: "set_root", lps });
        station.disarm();
        break;
      case "add":
        this.#edit({ kind: "add-branch", lps, even_without_evidence: false });
        this.#forget();
        break;
      case "bridge":
        this.#edit({ kind: "bridge", lps });
        station.disarm();
        break;
      case "reroot":
        this.#edit({ kind: "move-root", lps });
        station.disarm();
        break;
      case "fork":
        if (forkHeld !== null) {
          this.#edit({ kind: "move-fork", branch_id: forkHeld, lps });
          station.disarm();
        }
        break;
      case "lesion-add":
      case "lesion-cut":
      case "cut":
      case "smooth":
      case "paint":
      case "erase":
      case null:
        break;
    }
  }

  /** Add a point to the brush stroke in a planar view; return false if no brush is active. */
  stroke(viewport: Viewport, at: PointerPlace): boolean {
    const station = this.#station;
    const { armed, stroke } = station.state.ui;
    if (!isBrush(armed)) return false;
    const lps = flatPoint(viewport, at);
    const cursor = { view: viewport.view, x: at.x, y: at.y };
    station.ui(lps === null ? { cursor } : { cursor, cursorLps: lps, stroke: [...stroke, lps] });
    this.#strokeView = viewport.header?.view ?? viewport.view;
    return true;
  }

  #strokeView: ViewName | null = null;

  endStroke(): void {
    const station = this.#station;
    const { armed, stroke, brushMm, brushIsBall } = station.state.ui;
    if (!isBrush(armed) || stroke.length === 0) return;
    if (isLesionBrush(armed)) {
      const target = station.state.ui.brushedTarget;
      if (target !== null) {
        station.send({
          type: "brush_target",
          target_id: target,
          stroke_lps: strokePoints(stroke, brushMm),
          brush_mm: brushMm,
          takes_away: armed === "lesion-cut",
        });
      }
      station.ui({ stroke: [] });
      return;
    }
    const drawnIn = brushIsBall || this.#strokeView === null ? null : VIEWS[this.#strokeView].plane;
    const plane = drawnIn ?? "ball";
    this.#edit({
      kind: "paint-lumen",
      points_lps: strokePoints(stroke, brushMm),
      radius_mm: brushMm,
      plane,
      erase: armed === "erase",
    });
    station.ui({ stroke: [] });
  }

  /** Apply the active branch tool to the whole branch of a clicked list row. */
  clickRow(branchId: number): void {
    this.#onBranch(branchId, null);
  }

  #onBranch(branchId: number | null, place: TreePlace | null): void {
    const station = this.#station;
    const { tree, ui } = station.state;
    if (tree === null || branchId === null) {
      station.notice("No branch here. Click a segmented airway.");
      return;
    }
    if (ui.armed === "cut") {
      this.#edit({ kind: "cut-branch", branch_id: branchId, at_mm: cutMm(place?.alongMm ?? 0) });
    } else if (ui.armed === "smooth") {
      this.#edit({ kind: "smooth-branch", branch_id: branchId });
    } else {
      const held = forkOf(tree, branchId, place?.alongMm ?? 0);
      if (held === null) station.notice("This branch has no fork to move.");
      else station.ui({ forkHeld: held });
    }
  }

  #edit(edit: EditTreeMessage["edit"]): void {
    this.#station.send({ type: "edit_tree", edit });
  }

  #under(viewport: Viewport, at: PointerPlace): Pointed | null {
    const { header } = viewport;
    const pixel = viewport.pixelAt(at);
    if (header === null || pixel === null) return null;
    const { tree, pose, session, ui } = this.#station.state;
    const ofTree = (place: TreePlace | null, lps: Vec3): Pointed => ({
      lps,
      branchId: place?.branchId ?? null,
      place,
      pixel: null,
    });
    const inLumen = (lps: Vec3): Pointed => ofTree(tree === null ? null : placeInLumen(tree.index, lps), lps);
    const flat = flatPoint(viewport, at);
    if (flat !== null) return inLumen(flat);
    const geometry = geometryOf(header);
    if (geometry === null || geometry.kind !== "seen") return null;
    switch (VIEWS[header.view].pick) {
      case "planes": {
        const centre = this.#station.centre();
        const grid = session?.case;
        const hit = grid == null || centre === null ? null : planeUnder(geometry, grid, centre, pixel);
        return hit === null ? null : inLumen(hit.lps);
      }
      case "branch": {
        const reach = wasFinger() ? FINGER_REACH : 1;
        const place =
          tree === null
            ? null
            : placeFromOutside(tree.index, geometry, pixel, reach / Math.max(viewport.magnification, 1e-6));
        return place === null ? null : ofTree(place, place.lps);
      }
      case "wall": {
        if (!isInside(viewport.shape, viewport.frame, at)) return null;
        const here = pose?.branch_id ?? null;
        const ahead = tree === null || here === null ? null : branchAhead(tree, here, geometry, pixel);
        // The branch of the tip fills the view around the openings. Only an active branch tool selects that branch.
        const means = ahead !== here || wantsBranch(ui.armed, ui.forkHeld !== null);
        return { lps: null, branchId: means ? ahead : null, place: null, pixel };
      }
      default:
        return null;
    }
  }
}

/** Distance, mm, from the beginning of a branch within which a cut removes the whole branch. */
const WHOLE_MM = 2;
const cutMm = (alongMm: number): number => (alongMm < WHOLE_MM ? 0 : alongMm);

function questionOf(header: PictureHeader | null, pointed: Pointed): LiveQuestion | null {
  if (pointed.lps !== null) return { lps: pointed.lps, frame_id: null, column: null, row: null };
  if (pointed.pixel === null || header === null) return null;
  const { column, row } = pointed.pixel;
  if (column < 0 || row < 0 || column > header.width || row > header.height) return null;
  return { lps: null, frame_id: header.frame_id, column, row };
}

/**
 * Return the patient point under a position in a slice, the cut-plane or a picture along the route; null in camera
 * views.
 */
function flatPoint(viewport: Viewport, at: PointerPlace): Vec3 | null {
  const { header } = viewport;
  const pixel = viewport.pixelAt(at);
  if (header === null || pixel === null || VIEWS[header.view].pick === null) return null;
  const lines = linesOf(header.lines);
  if (lines !== null) return lpsAt(lines, pixel);
  const geometry = geometryOf(header);
  return geometry?.kind === "flat" ? lpsFromPixel(geometry, pixel) : null;
}
