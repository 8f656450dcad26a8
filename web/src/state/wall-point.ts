/** Points of the airway wall that the user has clicked: position, distance from the lens, and voxel value. */

import type { PickedMessage } from "../wire/messages";
import { coordinates, fixed, mm } from "./format";
import { asVec3, distance, type Vec3 } from "./vec";

/** A clicked point of the airway wall. */
export interface WallPoint {
  readonly lps: Vec3;
  readonly depthMm: number;
  /** Voxel value in HU, or in the file's units; null outside the volume. */
  readonly voxelValue: number | null;
  readonly branchName: string | null;
  readonly branchId: number | null;
  readonly generation: number | null;
}

/** Maximum number of marked wall points: two, for a distance measurement; a third one replaces the oldest. */
const MAX_POINTS = 2;

/**
 * Return the wall points with the point of a new answer, and without the oldest if there are too many; unchanged if the
 * click hit no wall.
 */
export function addPick(points: readonly WallPoint[], answer: PickedMessage): readonly WallPoint[] {
  if (answer.lps === null || answer.depth_mm === null) return points;
  const point = {
    lps: asVec3(answer.lps),
    depthMm: answer.depth_mm,
    voxelValue: answer.voxel_value,
    branchName: answer.branch_name,
    branchId: answer.branch_id,
    generation: answer.generation,
  };
  return [...points, point].slice(-MAX_POINTS);
}

/** Return the straight distance between the last two wall points, mm; null with fewer than two. */
export function pointsApartMm(points: readonly WallPoint[]): number | null {
  const [before, latest] = points.slice(-MAX_POINTS);
  return before === undefined || latest === undefined ? null : distance(before.lps, latest.lps);
}

/**
 * Return the facts about the latest wall point, one per line. `label` is the list's name of the branch, which replaces
 * a missing name.
 */
export function wallPointLines(points: readonly WallPoint[], label: string | null, isHu: boolean): readonly string[] {
  const latest = points.at(-1);
  if (latest === undefined) return [];
  // Put longer lines first, because the round picture leaves more space at the top of the corner.
  const lines = [coordinates(latest.lps)];
  const branch = latest.branchName ?? label;
  if (branch !== null) {
    lines.push(latest.generation === null ? branch : `${branch}, generation ${latest.generation}`);
  }
  // State that the distance was measured at the click, because the tip moves on.
  lines.push(`${mm(latest.depthMm)} away when clicked`);
  if (latest.voxelValue !== null) lines.push(`${fixed(latest.voxelValue)}${isHu ? " HU" : " (not HU)"}`);
  const apart = pointsApartMm(points);
  if (apart !== null) lines.push(`${mm(apart)} apart`);
  return lines;
}
