/**
 * Overlay of the vessels around the airway tree, as lines. Near vessels hide far vessels, and airways hide the vessels
 * behind them.
 */

import { pixelFromLps, type SeenGeometry } from "../state/projection";
import { asVec3, dot, sub, type Vec3 } from "../state/vec";
import type { Ink } from "./ink";
import { layerColour } from "./overlay-layers";
import type { Scene, SceneLesion } from "./scene";
import type { Viewport } from "./viewport";

/** Number of depth levels into which the lines are sorted, from far to near; far lines are fainter. */
const NUM_DEPTHS = 8;
const ALPHAS = [0.22, 0.7] as const;
/** Step of the line widths, px. Vessels whose widths round to the same step are stroked together. */
const WIDTH_STEP_PX = 0.5;
/** Minimum width of the line of a vessel, px; thinner vessels are widened. */
const MIN_PX = 0.75;

/** Collection of lines by depth level and width; lines of the same level and width are stroked together. */
class Strokes {
  readonly #paths = new Map<string, { path: Path2D; depth: number; width: number; sure: boolean }>();

  at(depth: number, widthPx: number, sure = true): Path2D {
    const width = Math.max(Math.round(widthPx / WIDTH_STEP_PX) * WIDTH_STEP_PX, MIN_PX);
    const key = `${depth} ${width} ${sure}`;
    const known = this.#paths.get(key);
    if (known !== undefined) return known.path;
    const path = new Path2D();
    this.#paths.set(key, { path, depth, width, sure });
    return path;
  }

  of(depth: number): { path: Path2D; width: number; sure: boolean }[] {
    return [...this.#paths.values()].filter((one) => one.depth === depth);
  }
}

interface CachedDrawing {
  readonly canvas: HTMLCanvasElement;
  readonly of: readonly unknown[];
}

/**
 * Drawing of the vessels for each viewport, valid until the camera of the view moves. This camera does not follow the
 * tip.
 */
const DRAWINGS = new WeakMap<Viewport, CachedDrawing>();

/** Draw the vessels as lines in their width; uncertain vessels are dashed and fainter. */
export function paintVessels(ink: Ink, viewport: Viewport, geometry: SeenGeometry, scene: Scene): void {
  if (scene.vessels.length === 0) {
    DRAWINGS.delete(viewport);
    return;
  }
  const of = [viewport.version, scene.vessels, scene.tree, scene.lesions];
  let drawing = DRAWINGS.get(viewport);
  if (drawing === undefined || drawing.of.some((one, n) => one !== of[n])) {
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [viewport.overlay.width, viewport.overlay.height];
    const own = canvas.getContext("2d");
    if (own === null) return;
    own.setTransform(ink.getTransform());
    strokeVessels(own, viewport, geometry, scene);
    drawing = { canvas, of };
    DRAWINGS.set(viewport, drawing);
  }
  ink.drawImage(drawing.canvas, 0, 0, viewport.size.width, viewport.size.height);
}

function strokeVessels(ink: Ink, viewport: Viewport, geometry: SeenGeometry, scene: Scene): void {
  const { camera, focalPx } = geometry;
  const depthOf = (points: readonly (readonly number[])[]): number =>
    dot(sub(asVec3(points[points.length >> 1] ?? [0, 0, 0]), camera.position), camera.forward);
  const depths = scene.vessels.map(({ points_lps: points }) => depthOf(points));
  const near = depths.reduce((a, b) => Math.min(a, b), Number.POSITIVE_INFINITY);
  const far = depths.reduce((a, b) => Math.max(a, b), Number.NEGATIVE_INFINITY);
  const binOf = (depthMm: number): number => {
    const part = far > near ? (far - depthMm) / (far - near) : 1;
    return Math.min(Math.max(Math.floor(part * NUM_DEPTHS), 0), NUM_DEPTHS - 1);
  };
  const px = (mm: number, depthMm: number): number => (mm * focalPx * viewport.magnification) / Math.max(depthMm, 1);
  const [vessels, airways] = [new Strokes(), new Strokes()];
  for (const [n, { points_lps: points, diameter_mm: diameter, sure }] of scene.vessels.entries()) {
    const depth = depths[n] ?? far;
    const path = vessels.at(binOf(depth), sure ? px(diameter, depth) : MIN_PX, sure);
    let begun = false;
    for (const point of points) {
      const lps = asVec3(point);
      const seen = scene.lesions.some((lesion) => isInside(lesion, lps)) ? null : pixelFromLps(geometry, lps);
      if (seen !== null) {
        const at = viewport.screenAt(seen);
        if (begun) path.lineTo(at.x, at.y);
        else path.moveTo(at.x, at.y);
      }
      begun = seen !== null;
    }
  }
  for (const { branch } of scene.tree?.byId.values() ?? []) {
    branch.points.slice(1).forEach((point, n) => {
      const [from, to] = [branch.points[n] ?? point, point].map((end) => pixelFromLps(geometry, asVec3(end)));
      if (from == null || to == null) return;
      const path = airways.at(binOf(to.depthMm), px(2 * (branch.radius[n + 1] ?? 0), to.depthMm));
      const [a, b] = [viewport.screenAt(from), viewport.screenAt(to)];
      path.moveTo(a.x, a.y);
      path.lineTo(b.x, b.y);
    });
  }
  ink.save();
  ink.lineCap = ink.lineJoin = "round";
  ink.strokeStyle = layerColour("vessels");
  for (let depth = 0; depth < NUM_DEPTHS; depth++) {
    ink.globalCompositeOperation = "source-over";
    const alpha = ALPHAS[0] + ((ALPHAS[1] - ALPHAS[0]) * depth) / (NUM_DEPTHS - 1);
    for (const { path, width, sure } of vessels.of(depth)) {
      ink.globalAlpha = alpha * (sure ? 1 : 0.6);
      ink.lineWidth = width;
      ink.setLineDash(sure ? [] : [2, 2.5]);
      ink.stroke(path);
    }
    // Erase the lines over airways, because the airway picture is below the overlay.
    ink.globalCompositeOperation = "destination-out";
    ink.globalAlpha = 1;
    ink.setLineDash([]);
    for (const { path, width } of airways.of(depth)) {
      ink.lineWidth = width;
      ink.stroke(path);
    }
  }
  ink.restore();
}

/** Return whether a patient point is inside a target; lines inside a target are not drawn. */
function isInside({ centre, surface }: SceneLesion, point: Vec3): boolean {
  const [first] = surface.vertices;
  if (first === undefined) return false;
  const away = Math.hypot(...sub(point, centre));
  return away < Math.hypot(...sub(first, centre));
}
