/** Search of the path to the next target: through the lumen, or by the paper's edge costs through the whole scan. */

import type { AddTargetMessage, ArmPenMessage, StateMessage, Target } from "../wire/messages";
import { mm } from "./format";
import { marksByPen } from "./pen";
import { endText, originText, placeText, type WithOrigin } from "./route";
import type { Armed } from "./tools";
import { asVec3, type Vec3 } from "./vec";

/** Name of a cost function of the path search. */
export type PathCost = Target["cost"];

/** Label and explanation of each cost function. */
export const COST_TEXTS: Readonly<Record<PathCost, { readonly label: string; readonly words: string }>> = {
  lumen: { label: "Lumen", words: "Follow the middle of the segmented airways" },
  walls: {
    label: "Walls",
    words: "Search the whole scan; walls are costly (section 6.3 of the paper). Needs a start point, but no airways.",
  },
  paper: {
    label: "Paper",
    words:
      "Search the whole scan with the formula of section 6.2 as printed. Walls are cheap in it: the path follows edges.",
  },
};

const USUAL_COSTS: readonly PathCost[] = ["lumen", "walls"];
/** All cost functions, in display order. */
export const ALL_COSTS: readonly PathCost[] = [...USUAL_COSTS, "paper"];

/** Return the cost functions that a scan without airways offers: the usual ones, and the selected one. */
export const offeredCosts = (selected: PathCost): readonly PathCost[] =>
  ALL_COSTS.filter((cost) => cost === selected || USUAL_COSTS.includes(cost));

interface Search {
  readonly pathCost: PathCost;
  readonly pathStart: Vec3 | null;
}

/**
 * Return the start point of the next path: the marked start, else the start of the latest target with this cost
 * function, else the root of the airways. Null if none exists.
 */
export function startOf(ui: Search, session: Pick<StateMessage, "targets" | "root_lps"> | null): Vec3 | null {
  if (ui.pathStart !== null) return ui.pathStart;
  const before = session?.targets.findLast((target) => target.root_lps !== null)?.root_lps ?? null;
  const start = before ?? session?.root_lps ?? null;
  return start === null ? null : asVec3(start);
}

/** Return the command that adds a target; null if its cost function needs a start point and has none. */
export function targetMessage(
  lps: Vec3,
  ui: Search,
  session: Pick<StateMessage, "targets" | "root_lps"> | null,
): AddTargetMessage | null {
  if (ui.pathCost === "lumen") return { type: "add_target", lps };
  const start = startOf(ui, session);
  return start === null ? null : { type: "add_target", lps, cost: ui.pathCost, root_lps: start };
}

/** Return the message that tells the server which point the pen's button marks. */
export function penMessage(
  ui: Search & { readonly armed: Armed | null },
  session: Pick<StateMessage, "targets" | "root_lps"> | null,
): ArmPenMessage {
  const tool = marksByPen(ui.armed) ? ui.armed : null;
  if (tool !== "target" || ui.pathCost === "lumen") return { type: "arm_pen", tool };
  return { type: "arm_pen", tool, cost: ui.pathCost, root_lps: startOf(ui, session) };
}

/** Return whether two messages select the same use of the pen's button. */
export function isSamePen(one: ArmPenMessage, other: ArmPenMessage): boolean {
  const start = (message: ArmPenMessage) => message.root_lps?.join(" ") ?? null;
  return one.tool === other.tool && one.cost === other.cost && start(one) === start(other);
}

const NO_CROSSINGS: readonly number[] = [];

/** Return the places in mm from the start where the path of a route to a target crosses the wall of the lumen. */
export function crossingsOf(
  targetId: string | null,
  targets: readonly Pick<Target, "target_id" | "crossings_mm">[],
): readonly number[] {
  return targets.find((target) => target.target_id === targetId)?.crossings_mm ?? NO_CROSSINGS;
}

/** Return a number of crossings as text. */
const timesText = (count: number): string => (count === 1 ? "once" : `${count} times`);

/** Return the text of the mark where a path crosses the wall, with the origin of the ruler. */
export const crossingText = (route: WithOrigin, along: number): string =>
  `Crosses the airway wall, ${placeText(route, along)}`;

/** Return the label of the ruler's slider, which states how often the path crosses the wall. */
export function sliderLabel(route: WithOrigin, numCrossings: number): string {
  const label = `Position on the route in mm from ${originText(route)}`;
  return numCrossings === 0 ? label : `${label}; the path crosses the airway wall ${timesText(numCrossings)}`;
}

/** Maximum number of crossings in a text; the ruler of the route marks all of them. */
const MAX_CROSSINGS = 6;

/** Return where a path crosses the wall of the lumen as text; only the first crossings are listed. */
function crossingsText(crossings: readonly number[]): string {
  const listed = crossings.slice(0, MAX_CROSSINGS).map((along) => mm(along, 0));
  const more = crossings.length > MAX_CROSSINGS ? ", ..." : "";
  return `crosses the wall ${timesText(crossings.length)}, at ${listed.join(", ")}${more} from the start`;
}

/** Return the facts about a target's path as text. */
export function pathText(target: Target, isHu: boolean): string {
  if (target.length_mm === null) return "";
  if (target.cost === "lumen") {
    const moved =
      target.snapped_mm === null || target.snapped_mm < 0.05 ? "" : `, moved ${mm(target.snapped_mm)} into the lumen`;
    return endText({ length_mm: target.length_mm, from_carina_mm: target.from_carina_mm }) + moved;
  }
  const parts = [`${mm(target.length_mm, 0)} from the start`, `cost ${target.cost}`];
  if (target.outside_mm !== null) {
    parts.push(target.outside_mm < 0.05 ? "all in the lumen" : `${mm(target.outside_mm, 0)} outside the lumen`);
    if (target.crossings_mm?.length) parts.push(crossingsText(target.crossings_mm));
  } else parts.push("not compared with a lumen");
  if (target.value_range !== null) {
    const [low, high] = target.value_range;
    parts.push(`values ${low} to ${high}${isHu ? " HU" : ""}`);
  }
  return parts.join(", ");
}
