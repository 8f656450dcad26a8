/** Problem of the machine that the status bar states beside its dot. */

import { LEAD_VIEW } from "../wire/views";
import { type AppState, isLeadShown } from "./app-state";
import { clusterText, needsLook } from "./cluster-text";

/** Waiting time for an airway picture, ms, above which the status bar warns. */
const LATE_MS = 700;

type Seen = Pick<AppState, "ui" | "frames" | "pace" | "cluster">;

/**
 * Return the problem of the machine as text; null while the machine keeps up. An airway view that another view covers is
 * not a problem, because nobody sees that its picture is late.
 */
export function machineTrouble(state: Seen): string | null {
  if (isLeadShown(state)) {
    if (state.pace.waitingMs > LATE_MS) return "updating\u2026";
    if ((state.frames[LEAD_VIEW]?.stands_for ?? null) !== null) return "viewfinder";
  }
  return state.cluster !== null && needsLook(state.cluster) ? clusterText(state.cluster) : null;
}
