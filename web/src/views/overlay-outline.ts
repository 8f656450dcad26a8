/** Overlay of the airways on slices and the cut-plane: the outline of the lumen, and the centrelines near the plane. */

import type { BranchNode, BranchTree } from "../state/airways";
import { isDoubtful } from "../state/branch-text";
import { type FlatGeometry, mmPerPixel, normalOf, pixelFromLps } from "../state/projection";
import { sphereOf } from "../state/spheres";
import { asVec3, column, dot, sub, type Vec3 } from "../state/vec";
import { VIEWS } from "../wire/views";
import { INK, type Ink, label, type ScreenPoint } from "./ink";
import { LOBE_COLOURS } from "./overlay-names";
import type { Scene } from "./scene";
import type { Viewport } from "./viewport";

/** Width of the drawn lumen outline, CSS px. */
const OUTLINE_PX = 1.25;
/**
 * Opacity of the lumen outline on a thick slice; the outline is valid for one plane and differs in the others of the
 * slab.
 */
const SLAB_ALPHA = 0.6;
/** Width of a drawn centreline, CSS px. */
const LINE_PX = 1.5;
/** Radius of the lumen, px, below which its outline is thinner, so that the lumen stays visible. */
const NARROW_PX = 4;
/** Distance, mm, over which a centreline fades out on both sides of the plane. */
const FADE_MM = 2;
const ALPHAS = [1, 0.7, 0.45, 0.2] as const;
const DOTTED: readonly number[] = [1, 3];
const DOT_PX = { least: 1.25, most: 3, ofRadius: 0.25 } as const;
/**
 * Minimum distance, px, between the dots that mark where a centreline crosses the plane. A winding centreline crosses
 * the plane often.
 */
const DOTS_APART_PX = 8;

/** Draw the outline of the lumen on the displayed picture. */
export function paintOutline(ink: Ink, viewport: Viewport, scene: Scene): void {
  const { header, outline } = viewport;
  if (!scene.outlineVisible || header === null) return;
  if (header.outline?.complete === false) {
    const at = { x: viewport.size.width / 2, y: viewport.size.height - 34 };
    label(ink, "no outline: the lumen is too irregular", at, { size: 11, colour: INK.warning });
  }
  if (outline === null) return;
  const origin = viewport.screenAt({ column: 0, row: 0 });
  const end = viewport.screenAt({ column: header.width, row: header.height });
  const [perColumn, perRow] = [(end.x - origin.x) / header.width, (end.y - origin.y) / header.height];
  ink.save();
  ink.translate(origin.x, origin.y);
  ink.scale(perColumn, perRow);
  ink.strokeStyle = INK.lumen;
  ink.lineWidth = OUTLINE_PX / Math.sqrt(perColumn * perRow);
  ink.lineJoin = "round";
  ink.lineCap = "round";
  if (isThick(viewport, scene)) ink.globalAlpha = SLAB_ALPHA;
  ink.stroke(outline);
  ink.restore();
}

/** Return whether the picture is a thick slice; only slices can be thick. */
const isThick = ({ header }: Viewport, scene: Scene): boolean =>
  header !== null && VIEWS[header.view].slab === "window" && scene.slab.thickness_mm > 0;

/** Draw the centrelines near the plane. */
export function paintCentrelines(ink: Ink, viewport: Viewport, geometry: FlatGeometry, scene: Scene): void {
  if (!scene.outlineVisible || scene.tree === null) return;
  const solidMm = solidWithin(geometry, viewport, scene);
  const normal = normalOf(geometry);
  for (const node of branchesNear(scene.tree, geometry.origin, normal, solidMm + FADE_MM)) {
    // Skip branches drawn by hand, which `paintDrawn` draws dashed above everything else, and which the user cannot
    // hide.
    if (node.branch.kind === "tracked") paintBranch(ink, viewport, geometry, node, solidMm);
  }
}

/**
 * Return the distance from the plane, mm, within which a branch counts as in the plane: half a voxel across the plane,
 * or half the slab of a thick slice.
 */
function solidWithin(geometry: FlatGeometry, viewport: Viewport, scene: Scene): number {
  if (isThick(viewport, scene)) return scene.slab.thickness_mm / 2;
  const { grid } = scene;
  if (grid === null) return 0.5;
  const normal = normalOf(geometry);
  const axes = [0, 1, 2].map((axis) => Math.abs(dot(column(grid.lps_from_ijk, axis as 0 | 1 | 2), normal)));
  return Math.max(...axes) / 2;
}

function branchesNear(tree: BranchTree, origin: Vec3, normal: Vec3, withinMm: number): BranchNode[] {
  return [...tree.byId.values()].filter((node) => {
    const sphere = sphereOf(node);
    return sphere !== null && Math.abs(dot(sub(sphere.centre, origin), normal)) <= sphere.radiusMm + withinMm;
  });
}

function paintBranch(ink: Ink, viewport: Viewport, geometry: FlatGeometry, node: BranchNode, solidMm: number): void {
  const { points, radius } = node.branch;
  const cssPerMm = viewport.magnification / mmPerPixel(geometry);
  const colour = node.lobe === null ? INK.text : LOBE_COLOURS[node.lobe];
  const doubtful = isDoubtful(node);
  const seen = points.map((point) => {
    const pixel = pixelFromLps(geometry, asVec3(point));
    return pixel === null ? null : { ...viewport.screenAt(pixel), depthMm: pixel.depthMm };
  });
  let run: ScreenPoint[] = [];
  let level = -1;
  let width = LINE_PX;
  const flush = () => {
    const alpha = ALPHAS[level];
    if (run.length > 1 && alpha !== undefined) stroke(ink, run, colour, width, alpha, doubtful);
    run = [];
  };
  const dots: (ScreenPoint & { radiusPx: number })[] = [];
  for (let n = 1; n < seen.length; n += 1) {
    const [a, b] = [seen[n - 1], seen[n]];
    if (a == null || b == null) {
      flush();
      level = -1;
      continue;
    }
    const radiusPx = ((radius[n - 1] ?? 0) + (radius[n] ?? 0)) * 0.5 * cssPerMm;
    const now = levelOf(Math.abs(a.depthMm + b.depthMm) / 2, solidMm);
    const nowWidth = radiusPx < NARROW_PX ? 1 : LINE_PX;
    if (now !== level || nowWidth !== width) {
      flush();
      [level, width] = [now, nowWidth];
      run = [a];
    }
    run.push(b);
    if (a.depthMm < 0 === b.depthMm < 0) continue;
    const t = a.depthMm / (a.depthMm - b.depthMm);
    const at = { x: a.x + t * (b.x - a.x), y: a.y + t * (b.y - a.y) };
    if (dots.every((dot) => Math.hypot(dot.x - at.x, dot.y - at.y) >= DOTS_APART_PX)) dots.push({ ...at, radiusPx });
  }
  flush();
  for (const { radiusPx, ...at } of dots) {
    const size = Math.min(Math.max(DOT_PX.ofRadius * radiusPx, DOT_PX.least), DOT_PX.most);
    ink.save();
    ink.fillStyle = colour;
    ink.strokeStyle = INK.halo;
    ink.lineWidth = 1;
    ink.beginPath();
    ink.arc(at.x, at.y, size, 0, 2 * Math.PI);
    if (size >= 2) ink.stroke();
    ink.fill();
    ink.restore();
  }
}

/**
 * Return the opacity level of a centreline point at a distance from the plane; nothing is drawn beyond the last level.
 */
function levelOf(depthMm: number, solidMm: number): number {
  if (depthMm <= solidMm) return 0;
  return 1 + Math.floor(((depthMm - solidMm) / FADE_MM) * (ALPHAS.length - 1));
}

function stroke(
  ink: Ink,
  points: readonly ScreenPoint[],
  colour: string,
  width: number,
  alpha: number,
  dotted: boolean,
): void {
  ink.save();
  ink.globalAlpha = alpha;
  ink.strokeStyle = colour;
  ink.lineWidth = width;
  ink.lineJoin = "round";
  ink.lineCap = dotted ? "butt" : "round";
  if (dotted) ink.setLineDash([...DOTTED]);
  ink.beginPath();
  points.forEach((point, n) => {
    if (n === 0) ink.moveTo(point.x, point.y);
    else ink.lineTo(point.x, point.y);
  });
  ink.stroke();
  ink.restore();
}
