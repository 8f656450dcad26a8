/**
 * The three planes of the tri-plane view as its camera sees them: their outlines, the plane under the cursor, and the
 * distance that a drag moves a plane along its normal. As in the ray caster, the first plane that a ray meets inside
 * the volume is visible.
 */

import type { PlaneName } from "../wire/views";
import { type PixelPoint, pixelFromLps, type SeenGeometry } from "./projection";
import { add, column, cross, dot, scale, sub, unit, type Vec3 } from "./vec";
import { planeAcross } from "./view-table";
import type { Grid } from "./volume";

const AXES: readonly [Vec3, Vec3, Vec3] = [
  [1, 0, 0],
  [0, 1, 0],
  [0, 0, 1],
];

/** The plane under the cursor, and the point of the plane under the cursor. */
export interface PlaneHit {
  readonly plane: PlaneName;
  readonly axis: 0 | 1 | 2;
  readonly lps: Vec3;
}

function box(grid: Grid): { origin: Vec3; edges: readonly [Vec3, Vec3, Vec3] } {
  const [nz, ny, nx] = grid.shape_zyx;
  const steps = [0, 1, 2].map((index) => column(grid.lps_from_ijk, index));
  const counts = [nx ?? 1, ny ?? 1, nz ?? 1];
  const edges = steps.map((step, index) => scale(step, counts[index] ?? 1));
  const half = steps.reduce<Vec3>((sum, step) => add(sum, scale(step, -0.5)), [0, 0, 0]);
  const [i, j, k] = edges;
  return {
    origin: add(column(grid.lps_from_ijk, 3), half),
    edges: [i ?? [0, 0, 0], j ?? [0, 0, 0], k ?? [0, 0, 0]],
  };
}

/** Return whether a patient point is inside the box of the voxels. */
export function isInside(grid: Grid, lps: Vec3): boolean {
  const { origin, edges } = box(grid);
  const volume = dot(edges[0], cross(edges[1], edges[2]));
  if (volume === 0) return false;
  const offset = sub(lps, origin);
  return [cross(edges[1], edges[2]), cross(edges[2], edges[0]), cross(edges[0], edges[1])].every((normal) => {
    const part = dot(offset, normal) / volume;
    return part >= 0 && part <= 1;
  });
}

/** Return the unit direction, LPS, of the ray through a position in the picture. */
function rayThrough(geometry: SeenGeometry, pixel: PixelPoint): Vec3 {
  const { camera, focalPx, width, height } = geometry;
  const across = scale(camera.right, (pixel.column - width / 2) / focalPx);
  const along = scale(camera.down, (pixel.row - height / 2) / focalPx);
  return unit(add(camera.forward, add(across, along)));
}

/** Return the visible plane under a position in the picture, with its point there; null on the background. */
export function planeUnder(geometry: SeenGeometry, grid: Grid, centre: Vec3, pixel: PixelPoint): PlaneHit | null {
  const dir = rayThrough(geometry, pixel);
  const origin = geometry.camera.position;
  const hits = ([0, 1, 2] as const)
    .map((axis) => ({ axis, t: (centre[axis] - origin[axis]) / dir[axis] }))
    .filter(({ t }) => Number.isFinite(t) && t > 0)
    .sort((a, b) => a.t - b.t);
  for (const { axis, t } of hits) {
    const lps = add(origin, scale(dir, t));
    if (isInside(grid, lps)) return { plane: planeAcross(axis), axis, lps };
  }
  return null;
}

/** Return the two elements that follow one of three elements in cyclic order. */
function others(three: readonly [Vec3, Vec3, Vec3], one: 0 | 1 | 2): [Vec3, Vec3] {
  const [x, y, z] = three;
  return one === 0 ? [y, z] : one === 1 ? [z, x] : [x, y];
}

/**
 * Return the corners of the part of a plane that is inside the volume, in order around the part; fewer than three
 * corners if the plane is outside the volume.
 */
export function outlineOf(grid: Grid, centre: Vec3, axis: 0 | 1 | 2): Vec3[] {
  const { origin, edges } = box(grid);
  const corners: Vec3[] = [];
  for (const along of [0, 1, 2] as const) {
    const [b, c] = others(edges, along);
    for (const [sb, sc] of [
      [0, 0],
      [0, 1],
      [1, 0],
      [1, 1],
    ] as const) {
      const from = add(origin, add(scale(b, sb), scale(c, sc)));
      const rise = edges[along][axis];
      const t = (centre[axis] - from[axis]) / rise;
      if (Number.isFinite(t) && t >= 0 && t <= 1) corners.push(add(from, scale(edges[along], t)));
    }
  }
  if (corners.length < 3) return [];
  const middle = scale(
    corners.reduce((sum, point) => add(sum, point), [0, 0, 0] as Vec3),
    1 / corners.length,
  );
  const [u, v] = others(AXES, axis);
  const angle = (point: Vec3) => Math.atan2(dot(sub(point, middle), v), dot(sub(point, middle), u));
  return corners.sort((a, b) => angle(a) - angle(b));
}

/**
 * Projected length of a plane's normal, px per mm, below which the normal points nearly to the viewer. An upward drag
 * then moves the plane nearer.
 */
const FACE_ON_PX_PER_MM = 0.35;

/** Return the distance along its normal, mm, by which a drag (picture px) moves a plane grabbed at a point. */
export function dragMm(
  geometry: SeenGeometry,
  grabbed: PlaneHit,
  moved: { readonly dx: number; readonly dy: number },
): number {
  const normal = AXES[grabbed.axis];
  const here = pixelFromLps(geometry, grabbed.lps);
  const there = pixelFromLps(geometry, add(grabbed.lps, normal));
  if (here === null || there === null) return 0;
  const [x, y] = [there.column - here.column, there.row - here.row];
  const pxPerMm = geometry.focalPx / here.depthMm;
  const size = x * x + y * y;
  if (Math.sqrt(size) > FACE_ON_PX_PER_MM * pxPerMm) return (moved.dx * x + moved.dy * y) / size;
  const towards = dot(normal, geometry.camera.forward) > 0 ? -1 : 1;
  return (-moved.dy / pxPerMm) * towards;
}
