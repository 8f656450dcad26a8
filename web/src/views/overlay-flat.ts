/**
 * Overlay of the slices, the cut-plane and the X-ray: crosshair, route, targets, tip, orientation letters and scale
 * bar.
 */

import { edgeLetters, lettersOf } from "../state/letters";
import {
  axesOf,
  type FlatGeometry,
  geometryOf,
  mmPerPixel,
  pixelFromLps,
  projectLine,
  scaleBar,
} from "../state/projection";
import { add, scale, type Vec3 } from "../state/vec";
import { planeAcross } from "../state/view-table";
import { isInterpolated, sliceOf } from "../state/volume";
import { PLANES, type PlaneName, VIEWS } from "../wire/views";
import {
  INK,
  type Ink,
  label,
  line,
  NamePlaces,
  PLANE_COLOURS,
  type ScreenPoint,
  startMark,
  targetMark,
  tipMark,
} from "./ink";
import { paintBrush, paintCursorNote, paintLivePath, paintPreview } from "./overlay-cursor";
import { paintLayers, paintStations } from "./overlay-layers";
import { paintLesionsFlat } from "./overlay-lesion";
import { paintCentrelines, paintOutline } from "./overlay-outline";
import { paintPen } from "./overlay-pen";
import { paintActedOn, paintDrawn, paintTree } from "./overlay-tree";
import type { Scene } from "./scene";
import type { Viewport } from "./viewport";
import { paintWallMarks } from "./wall-marks";

/** Distance of an object from a slice, mm, up to which the object counts as in the slice. */
const IN_PLANE_MM = 2.5;
/** Half the gap in the middle of the crosshair, CSS px. */
const GAP_PX = 9;

/** Draw the overlay of a planar picture. */
export function paintFlat(ink: Ink, viewport: Viewport, scene: Scene): void {
  const { header } = viewport;
  if (header === null) return;
  const geometry = geometryOf(header);
  if (geometry === null || geometry.kind !== "flat") return;
  const { pick, plane } = VIEWS[header.view];
  const seesThrough = pick === null;
  const isSubstitute = header.stands_for !== null;
  ink.save();
  // A planar picture that replaces the round airway view is clipped to the round shape; only the letters are outside
  // it.
  if (isSubstitute) clipToPicture(ink, viewport);
  const inPlane = (depthMm: number) => seesThrough || Math.abs(depthMm) <= IN_PLANE_MM;
  if (plane !== null) paintCrosshair(ink, viewport, geometry, scene, plane);
  if (!seesThrough) {
    paintLayers(ink, viewport, scene);
    paintOutline(ink, viewport, scene);
    paintCentrelines(ink, viewport, geometry, scene);
  }
  paintTree(ink, viewport, geometry, scene, inPlane);
  paintRoute(ink, viewport, geometry, scene, inPlane);
  paintLesionsFlat(ink, viewport, geometry, scene, seesThrough, inPlane);
  paintActedOn(ink, viewport, geometry, scene, inPlane);
  paintDrawn(ink, viewport, geometry, scene, inPlane);
  paintLivePath(ink, viewport, geometry, scene, inPlane);
  paintPreview(ink, viewport, geometry, scene, inPlane);
  const names = new NamePlaces();
  if (scene.start !== null) {
    const seen = pixelFromLps(geometry, scene.start);
    if (seen !== null) startMark(ink, viewport.screenAt(seen), inPlane(seen.depthMm) ? 1 : 0.35, names, viewport.size);
  }
  for (const target of scene.targets) {
    const seen = pixelFromLps(geometry, target.lps);
    if (seen === null) continue;
    const near = inPlane(seen.depthMm);
    const at = viewport.screenAt(seen);
    const colour = target.reachable ? INK.accent : INK.warning;
    // Where the slice cuts a target with a size, its cross-section is drawn instead of the mark.
    if (!target.hasSize || !near || seesThrough) targetMark(ink, at, colour, near ? 1 : 0.35);
    if (near && !seesThrough) names.name(ink, target.name, at, colour, viewport.size);
  }
  if (!seesThrough) {
    paintStations(ink, viewport, scene, names, (lps) => {
      const seen = pixelFromLps(geometry, lps);
      return seen === null ? null : { ...viewport.screenAt(seen), near: inPlane(seen.depthMm) };
    });
  }
  paintWallMarks(ink, viewport, geometry, scene, inPlane);
  if (scene.tip !== null) {
    const seen = pixelFromLps(geometry, scene.tip.position);
    const ahead = pixelFromLps(geometry, add(scene.tip.position, scale(scene.tip.forward, 6)));
    if (seen !== null) {
      const at = viewport.screenAt(seen);
      tipMark(ink, at, ahead === null ? null : minus(viewport.screenAt(ahead), at), inPlane(seen.depthMm));
    }
  }
  paintPen(ink, viewport, geometry, scene, inPlane);
  if (isSubstitute)
    paintScale(ink, viewport, mmPerPixel(geometry), { x: viewport.size.width / 2, y: viewport.frame.y + 40 });
  ink.restore();
  paintLetters(ink, viewport, axesOf(geometry));
  if (!isSubstitute) paintScale(ink, viewport, mmPerPixel(geometry));
  if (plane !== null) paintSlab(ink, viewport, scene);
  if (!seesThrough) {
    paintInterpolated(ink, viewport, geometry, scene);
    paintBrush(ink, viewport, scene, mmPerPixel(geometry) / viewport.magnification, (lps) => {
      const seen = pixelFromLps(geometry, lps);
      return seen === null ? null : viewport.screenAt(seen);
    });
  }
  paintCursorNote(ink, viewport, scene);
}

function clipToPicture(ink: Ink, viewport: Viewport): void {
  const { frame } = viewport;
  ink.beginPath();
  if (viewport.shape === "round") {
    ink.arc(frame.x + frame.width / 2, frame.y + frame.height / 2, frame.width / 2, 0, 2 * Math.PI);
  } else {
    ink.rect(frame.x, frame.y, frame.width, frame.height);
  }
  ink.clip();
}

const minus = (a: ScreenPoint, b: ScreenPoint): ScreenPoint => ({ x: a.x - b.x, y: a.y - b.y });

function paintCrosshair(ink: Ink, viewport: Viewport, geometry: FlatGeometry, scene: Scene, plane: PlaneName): void {
  if (scene.crosshair === null) return;
  const seen = pixelFromLps(geometry, scene.crosshair);
  if (seen === null) return;
  const at = viewport.screenAt(seen);
  const { width, height } = viewport.size;
  const alpha = scene.followsTip ? 0.55 : 0.9;
  // Each line of the crosshair is the intersection of the slice with another plane.
  const vertical = planeAcross(PLANES[plane].right_axis);
  const horizontal = planeAcross(PLANES[plane].down_axis);
  line(
    ink,
    [
      { x: at.x, y: 0 },
      { x: at.x, y: at.y - GAP_PX },
    ],
    PLANE_COLOURS[vertical],
    1,
    alpha,
  );
  line(
    ink,
    [
      { x: at.x, y: at.y + GAP_PX },
      { x: at.x, y: height },
    ],
    PLANE_COLOURS[vertical],
    1,
    alpha,
  );
  line(
    ink,
    [
      { x: 0, y: at.y },
      { x: at.x - GAP_PX, y: at.y },
    ],
    PLANE_COLOURS[horizontal],
    1,
    alpha,
  );
  line(
    ink,
    [
      { x: at.x + GAP_PX, y: at.y },
      { x: width, y: at.y },
    ],
    PLANE_COLOURS[horizontal],
    1,
    alpha,
  );
}

function paintRoute(
  ink: Ink,
  viewport: Viewport,
  geometry: FlatGeometry,
  scene: Scene,
  inPlane: (depthMm: number) => boolean,
): void {
  if (!scene.routeLineVisible) return;
  for (const run of scene.routeRuns.flatMap((points) => projectLine(geometry, points))) {
    line(
      ink,
      run.map((point) => viewport.screenAt(point)),
      INK.accent,
      1,
      0.4,
    );
    let part: ScreenPoint[] = [];
    for (const point of run) {
      if (inPlane(point.depthMm)) {
        part.push(viewport.screenAt(point));
      } else {
        line(ink, part, INK.accent, 2);
        part = [];
      }
    }
    line(ink, part, INK.accent, 2);
  }
}

/**
 * Draw the orientation letters of the four edges. With `sides`, the letters of the left and right edges are in the
 * upper corners, because the distance axis and the names use these edges.
 */
export function paintLetters(
  ink: Ink,
  viewport: Viewport,
  { right, down, up }: ReturnType<typeof axesOf> & { up?: Vec3 },
  sides: { left: number; right: number } | null = null,
): void {
  const letters = { ...edgeLetters(right, down), ...(up === undefined ? {} : { top: lettersOf(up) }) };
  const { width, height } = viewport.size;
  const size = Math.min(width, height) > 400 ? 15 : 12;
  const inset = size * 0.5 + 5;
  const style = { size, bold: true } as const;
  label(ink, letters.top, { x: width / 2, y: inset }, style);
  label(ink, letters.bottom, { x: width / 2, y: height - inset }, style);
  const sideY = sides === null ? height / 2 : inset;
  label(ink, letters.left, { x: sides?.left ?? 6, y: sideY }, { ...style, align: "left" });
  label(ink, letters.right, { x: sides?.right ?? width - 6, y: sideY }, { ...style, align: "right" });
}

const SLAB_TEXTS = { min: "min", max: "max", mean: "mean" } as const;

/** Draw the thickness and the projection of a thick slice as text. */
export function paintSlab(ink: Ink, viewport: Viewport, scene: Scene): void {
  if (scene.slab.thickness_mm <= 0) return;
  const { width, height } = viewport.size;
  const outlined = scene.outlineVisible && viewport.outline !== null ? ", outline of the central plane" : "";
  const words = `${SLAB_TEXTS[scene.slab.kind]} ${scene.slab.thickness_mm} mm${outlined}`;
  label(ink, words, { x: width - 8, y: height - 12 }, { size: 11, align: "right" });
}

/** Draw a text over a slice that was missing in the files: nothing was measured there. */
function paintInterpolated(ink: Ink, viewport: Viewport, geometry: FlatGeometry, scene: Scene): void {
  if (scene.grid === null || scene.interpolated.length === 0) return;
  const slice = sliceOf(scene.grid, geometry.origin, geometry.perColumn, geometry.perRow);
  if (!isInterpolated(slice, scene.interpolated)) return;
  const { width, height } = viewport.size;
  label(ink, "interpolated slice", { x: width / 2, y: height - 34 }, { size: 12, bold: true, colour: INK.warning });
}

/** Draw the scale bar in the lower left corner of the view, or centred at a given point. */
export function paintScale(
  ink: Ink,
  viewport: Viewport,
  mmPerPicturePx: number,
  middle: ScreenPoint | null = null,
): void {
  const mmPerCss = mmPerPicturePx / viewport.magnification;
  if (!(mmPerCss > 0)) return;
  const { width, height } = viewport.size;
  const bar = scaleBar(mmPerCss, Math.min(0.3 * width, 120));
  const x = middle === null ? 8 : middle.x - bar.px / 2;
  const y = middle === null ? height - 9 : middle.y;
  for (const [stroke, thick] of [
    [INK.halo, 4],
    [INK.text, 1.5],
  ] as const) {
    line(
      ink,
      [
        { x, y: y - 4 },
        { x, y },
        { x: x + bar.px, y },
        { x: x + bar.px, y: y - 4 },
      ],
      stroke,
      thick,
    );
  }
  label(ink, `${bar.mm} mm`, { x: x + 1, y: y - 8 }, { size: 11, align: "left", baseline: "bottom" });
}
