/** Points of the airway wall that a person clicked: where, how far from the lens, what the scan shows there. */

import type { PickedMessage } from "../wire/messages";
import { coordinates, fixed, mm } from "./format";
import { asVec3, distance, type Vec3 } from "./vec";

export interface WallPoint {
  readonly lps: Vec3;
  readonly depthMm: number;
  /** HU, or the file's numbers; null outside the volume. */
  readonly voxelValue: number | null;
  readonly branchName: string | null;
  readonly branchId: number | null;
  readonly generation: number | null;
}

/** Two, so that a distance can be read. */
const MAX_POINTS = 2;

/** With one more point, of an answer that met a wall. */
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

/** Straight from the point before to the newest; null while there is one point only. */
export function pointsApartMm(points: readonly WallPoint[]): number | null {
  const [before, newest] = points.slice(-MAX_POINTS);
  return before === undefined || newest === undefined ? null : distance(before.lps, newest.lps);
}

/** The newest point in words, one fact a line. `label` names its branch where the tree knows it. */
export function wallPointLines(points: readonly WallPoint[], label: string | null, isHu: boolean): readonly string[] {
  const newest = points.at(-1);
  if (newest === undefined) return [];
  // Long lines first: they stand where the round picture leaves the most room.
  const lines = [coordinates(newest.lps)];
  const branch = newest.branchName ?? label;
  if (branch !== null) {
    lines.push(newest.generation === null ? branch : `${branch}, generation ${newest.generation}`);
  }
  // The tip goes on, and this stays as it was measured.
  lines.push(`${mm(newest.depthMm)} away when clicked`);
  if (newest.voxelValue !== null) lines.push(`${fixed(newest.voxelValue)}${isHu ? " HU" : " (not HU)"}`);
  const apart = pointsApartMm(points);
  if (apart !== null) lines.push(`${mm(apart)} apart`);
  return lines;
}
