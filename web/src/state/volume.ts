/** The box of the open volume: its voxels span -0.5 to n-0.5 on each index axis. */

import type { CaseInfo } from "../wire/messages";
import { add, asVec3, column, cross, dot, scale, sub, type Vec3 } from "./vec";

/** The voxel grid of the open volume: its affine matrix and shape. */
export type Grid = Pick<CaseInfo, "lps_from_ijk" | "shape_zyx">;

/** Return a patient point with its voxel coordinates clamped to the box, LPS mm; correct for oblique grids. */
export function clampToVolume(grid: Grid, lps: Vec3): Vec3 {
  const axes = [column(grid.lps_from_ijk, 0), column(grid.lps_from_ijk, 1), column(grid.lps_from_ijk, 2)] as const;
  const origin = column(grid.lps_from_ijk, 3);
  const volume = dot(axes[0], cross(axes[1], axes[2]));
  if (volume === 0) return lps;
  const offset = sub(lps, origin);
  const ijk = [
    dot(offset, cross(axes[1], axes[2])) / volume,
    dot(offset, cross(axes[2], axes[0])) / volume,
    dot(offset, cross(axes[0], axes[1])) / volume,
  ] as const;
  const [nz, ny, nx] = grid.shape_zyx;
  const clamped = [clamp(ijk[0], nx), clamp(ijk[1], ny), clamp(ijk[2], nz)] as const;
  // Return a point inside the box unchanged, without the rounding of a conversion to voxel coordinates and back.
  if (clamped.every((value, axis) => value === ijk[axis])) return lps;
  return add(origin, add(add(scale(axes[0], clamped[0]), scale(axes[1], clamped[1])), scale(axes[2], clamped[2])));
}

/**
 * Distance of the limit from the centre of the outermost voxel, voxels. It is slightly below 0.5, because rounding may
 * move a point on the edge outside.
 */
const EDGE_VOX = 0.499;

const clamp = (value: number, count: number): number => Math.min(Math.max(value, -EDGE_VOX), count - 1 + EDGE_VOX);

/**
 * Return the index k of the volume's slice that a plane shows; null if the plane is not parallel to the slices.
 * The plane contains `origin` and the directions `right` and `down`, LPS mm.
 */
export function sliceOf(grid: Grid, origin: Vec3, right: Vec3, down: Vec3): number | null {
  const normal = cross(column(grid.lps_from_ijk, 0), column(grid.lps_from_ijk, 1));
  const step = dot(column(grid.lps_from_ijk, 2), normal);
  if (step === 0) return null;
  const length = Math.sqrt(dot(normal, normal));
  const slope = (direction: Vec3) => Math.abs(dot(direction, normal)) / (length * Math.sqrt(dot(direction, direction)));
  if (!(slope(right) < 1e-3 && slope(down) < 1e-3)) return null;
  return dot(sub(origin, column(grid.lps_from_ijk, 3)), normal) / step;
}

/** Return whether a plane shows an interpolated slice, or lies between one and a measured slice. */
export function isInterpolated(slice: number | null, interpolated: readonly number[]): boolean {
  return slice !== null && interpolated.some((index) => Math.abs(slice - index) < 0.999);
}

/** Return the middle of the volume's box, LPS mm. */
export function middleOf(info: Grid): Vec3 {
  const [nz, ny, nx] = asVec3(info.shape_zyx);
  return [nx, ny, nz].reduce<Vec3>(
    (sum, count, axis) => add(sum, scale(column(info.lps_from_ijk, axis), (count - 1) / 2)),
    column(info.lps_from_ijk, 3),
  );
}
