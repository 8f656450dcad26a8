/** The expert's flight: its path, and the place on the path that a ghost in the airway view shows. */

import { distance, type Vec3 } from "./vec";

/** Distance in mm along the expert's path, ahead of the trainee's tip, at which the expert's tip is shown. */
const AHEAD_MM = 10;
/**
 * Maximum distance in mm between the trainee's tip and the expert's path at which the trainee counts as on the path.
 */
const SAME_PLACE_MM = 8;
/**
 * Distance in mm beyond the nearest passage of the expert up to which a later passage counts as at the same position.
 */
const OTHER_PASS_MM = 3;
/** Minimum distance in mm between two stored points of the expert's path. */
const APART_MM = 1;

/** Positions of the expert's tip in the order of time, without repeated ones. */
export type ExpertPath = readonly Vec3[];

/** Return the positions of a recorded flight, from the lines of its file. */
export function pathOfRecording(text: string): ExpertPath {
  const found: Vec3[] = [];
  for (const row of text.split("\n")) {
    if (!row.includes('"pose"')) continue;
    const at = positionOf(row);
    const before = found.at(-1);
    if (at !== null && (before === undefined || distance(at, before) >= APART_MM)) found.push(at);
  }
  return found;
}

function positionOf(row: string): Vec3 | null {
  try {
    const { pose } = JSON.parse(row) as { pose?: unknown };
    if (!Array.isArray(pose) || pose.length !== 16) return null;
    const at: Vec3 = [Number(pose[3]), Number(pose[7]), Number(pose[11])];
    return at.every(Number.isFinite) ? at : null;
  } catch {
    return null;
  }
}

/**
 * Return the index on the expert's path of the place of a tip; null if the expert was not there. Of several passes the
 * first one at or after the previous index counts, so that the ghost goes the expert's way in its order.
 */
export function placeOnPath(path: ExpertPath, tip: Vec3, before: number): number | null {
  const away = path.map((point) => distance(point, tip));
  const least = Math.min(...away);
  if (!(least <= SAME_PLACE_MM)) return null;
  const near = away.flatMap((mm, n) => (mm <= least + OTHER_PASS_MM ? [n] : []));
  const pass = near.filter((n) => n >= before);
  const runStart = pass[0] ?? near[0] ?? 0;
  // The nearest point of this pass.
  let best = runStart;
  for (let n = runStart; n < path.length && (away[n] ?? Infinity) <= least + OTHER_PASS_MM; n += 1) {
    if ((away[n] ?? Infinity) < (away[best] ?? Infinity)) best = n;
  }
  return best;
}

/** Return the expert's tip ahead of a place on the path; the end of the path if it is nearer. */
export function ghostAhead(path: ExpertPath, from: number): Vec3 | null {
  const start = path[from];
  if (start === undefined) return null;
  return path.slice(from).find((point) => distance(point, start) >= AHEAD_MM) ?? path.at(-1) ?? null;
}
