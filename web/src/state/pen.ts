/** Texts about a tracked pen: the point that its button marks, and the offset between the pen and the scope's tip. */

import type { PenMessage, StateMessage } from "../wire/messages";
import { fixed, mm } from "./format";
import type { Armed } from "./tools";

/** Return whether the pen's button marks a point with the active tool. */
export const marksByPen = (armed: Armed | null): armed is "root" | "start" | "target" =>
  armed === "root" || armed === "start" || armed === "target";

/** Return which point the pen's button marks, as text. */
export function penMarkText(pen: PenMessage): string {
  if (pen.lps !== null) return "The pen\u2019s button marks the position of the pen tip.";
  return pen.tracked
    ? "The pen is not registered: its button marks the position of the scope tip."
    : "The position of this device is not tracked: its button marks the position of the scope tip.";
}

/** Offset between pen and tip, mm, below which no offset is shown: half of the last displayed digit. */
const JOINED_MM = 0.05;
/** Angle between pen and tip, degrees, below which no angle is shown. */
const JOINED_DEG = 0.5;

/**
 * Return the offset between pen and tip as text; null if the tip is at the pen, or does not follow the position of the
 * pen.
 */
export function penOffText(pen: PenMessage | null): string | null {
  if (pen === null || pen.off_mm === null) return null;
  const deg = pen.off_deg ?? 0;
  if (pen.off_mm < JOINED_MM && deg < JOINED_DEG) return null;
  const turned = deg < JOINED_DEG ? "" : `, ${fixed(deg)}\u00b0`;
  return `${mm(pen.off_mm)}${turned}`;
}

/** Return whether the pen's button has just used the active tool, which is then deactivated as after a click. */
export function wasUsedByPen(armed: Armed | null, before: StateMessage | null, now: StateMessage): boolean {
  if (before === null) return false;
  if (armed === "target") return now.targets.length > before.targets.length;
  return armed === "root" && now.airways === "finding" && before.airways !== "finding";
}
