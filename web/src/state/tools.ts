/** Tools that define the effect of the next click: mark a point (target, root, start), or edit the airway tree. */

import type { Target, ViewName } from "../wire/messages";
import { VIEWS } from "../wire/views";

/** Tools that edit the airway tree. */
export const TREE_TOOLS = ["add", "bridge", "cut", "fork", "smooth", "paint", "erase", "reroot"] as const;
/** Name of a tree tool. */
export type TreeTool = (typeof TREE_TOOLS)[number];
/** Name of a brush that edits a target's boundary. */
export type LesionTool = "lesion-add" | "lesion-cut";
/** Name of a tool that can be active. */
export type Armed = "target" | "root" | "start" | LesionTool | TreeTool;

/** Texts of a tool's button. */
export interface ToolTexts {
  readonly label: string;
  /** Short text below the icon of the button. */
  readonly short: string;
  /** Tooltip of the button. */
  readonly words: string;
  /** Instruction that is shown while the tool is active. */
  readonly hint: string;
}

/** Texts of each tree tool. */
export const TOOL_TEXTS: Readonly<Record<TreeTool, ToolTexts>> = {
  add: {
    label: "Add branch",
    short: "Add",
    words: "Add a branch: click the distal end of a missing airway",
    hint: "Click the distal end of the missing airway, in any view. The line shows the new branch, dashed where the CT shows no wall.",
  },
  bridge: {
    label: "Bridge",
    short: "Bridge",
    words: "Bridge an obstruction: click in the airway distal to it. The bridge stays marked.",
    hint: "Click in the airway distal to the obstruction. The CT shows no lumen across the gap: the bridge stays amber and is labelled \u201cbridge\u201d.",
  },
  cut: {
    label: "Cut",
    short: "Cut",
    words: "Remove a branch from the point you click, and everything distal to it",
    hint: "Click a branch, in a view or in the list. The amber part will be removed.",
  },
  fork: {
    label: "Move fork",
    short: "Move fork",
    words: "Move a fork: click near it, then where it belongs",
    hint: "Click near the fork to be moved, or click its branch in the list. The amber dot marks the fork.",
  },
  smooth: {
    label: "Smooth",
    short: "Smooth",
    words: "Smooth the centreline of a branch",
    hint: "Click a branch, in a view or in the list. The amber centreline will be smoothed.",
  },
  paint: {
    label: "Paint",
    short: "Paint",
    words: "Paint lumen in a slice",
    hint: "Draw in a slice where lumen is missing.",
  },
  erase: {
    label: "Erase",
    short: "Erase",
    words: "Erase lumen in a slice",
    hint: "Draw in a slice over lumen that should be removed.",
  },
  reroot: {
    label: "Set start",
    short: "Start",
    words: "Click where paths should start. The tree and your edits do not change.",
    hint: "Click where paths should start (usually the trachea).",
  },
};

/** Texts of the tools that mark a point or edit the boundary of a target. */
const MARK_TEXTS: Readonly<Record<"target" | "root" | "start" | LesionTool, Pick<ToolTexts, "label" | "hint">>> = {
  start: { label: "Mark start", hint: "Click where the path should start, in any view." },
  target: { label: "Mark target", hint: "Click a nodule, or a place in the airways, in any view." },
  "lesion-add": { label: "Paint target", hint: "Draw in a slice where the target is larger." },
  "lesion-cut": { label: "Erase target", hint: "Draw in a slice over what is not target." },
  root: {
    label: "Mark the trachea",
    hint: "Click inside the trachea. The airways are segmented again from its upper end; your edits are discarded (undo restores them).",
  },
};

/** Return the label and the instruction of the active tool. */
export function textsOf(armed: Armed, forkHeld: boolean): { label: string; hint: string } {
  if (armed === "fork" && forkHeld) {
    return {
      label: TOOL_TEXTS.fork.label,
      hint: "Now click where the fork belongs. The lines show what moves with it.",
    };
  }
  return isTreeTool(armed) ? TOOL_TEXTS[armed] : MARK_TEXTS[armed];
}

/** Return the short text of the active tool in the corner of a view, where it must not cover an orientation letter. */
export function shortOf(armed: Armed): string {
  switch (armed) {
    case "target":
      return "Target";
    case "root":
      return "Trachea";
    case "start":
      return "Start";
    case "reroot":
      return "Set start";
    case "lesion-add":
      return "Paint target";
    case "lesion-cut":
      return "Erase target";
    default:
      return TOOL_TEXTS[armed].short;
  }
}

/** Return whether the tool works in a view: an X-ray has no depth, and a brush needs a plane. */
export function worksIn(armed: Armed, view: ViewName): boolean {
  const { pick } = VIEWS[view];
  return isBrush(armed) ? pick === "plane" : pick !== null;
}

/** Return whether the tool removes something. */
export const takesAway = (armed: Armed): boolean => armed === "cut" || armed === "erase" || armed === "lesion-cut";

/** Return whether the tool edits the airway tree. */
export const isTreeTool = (armed: Armed | null): armed is TreeTool =>
  armed !== null && (TREE_TOOLS as readonly string[]).includes(armed);

/**
 * Return whether the path to the cursor is shown while the tool is active. Tree tools show a preview of the edit
 * instead.
 */
export function wantsPath(armed: Armed | null, cost: Target["cost"] = "lumen"): boolean {
  return armed === "target" && cost === "lumen";
}

/** Return whether a click with the tool selects a branch instead of a point. */
export function wantsBranch(armed: Armed | null, forkHeld: boolean): boolean {
  return armed === "cut" || armed === "smooth" || (armed === "fork" && !forkHeld);
}

/** Return whether the tool is a brush for a target's boundary. */
export const isLesionBrush = (armed: Armed | null): armed is LesionTool =>
  armed === "lesion-add" || armed === "lesion-cut";

/** Return whether the tool is a brush. */
export const isBrush = (armed: Armed | null): armed is "paint" | "erase" | LesionTool =>
  armed === "paint" || armed === "erase" || isLesionBrush(armed);

/** Brush radii that the keys select, mm. */
const BRUSHES_MM = [0.5, 0.75, 1, 1.5, 2, 3, 4, 6, 8, 12] as const;
/** Initial radius of the brush, mm. */
export const FIRST_BRUSH_MM = 1.5;

/** Return the next larger (+1) or smaller (-1) brush radius, mm; the last one of the list at its ends. */
export function nextBrush(radiusMm: number, step: -1 | 1): number {
  if (step > 0) return BRUSHES_MM.find((mm) => mm > radiusMm + 1e-6) ?? radiusMm;
  return BRUSHES_MM.findLast((mm) => mm < radiusMm - 1e-6) ?? radiusMm;
}

/**
 * Reduce the number of points of a brush stroke. The straight lines between the remaining points deviate from the drawn
 * stroke by at most a quarter of the brush radius.
 */
export function strokePoints<P extends readonly [number, number, number]>(drawn: readonly P[], radiusMm: number): P[] {
  const limit = radiusMm / 4;
  const reduced: P[] = [];
  for (const point of drawn) {
    const last = reduced.at(-1);
    const far =
      last === undefined ||
      Math.hypot(point[0] - last[0], point[1] - last[1], point[2] - last[2]) >= Math.max(limit, 0.1);
    if (far) reduced.push(point);
  }
  const end = drawn.at(-1);
  if (end !== undefined && reduced.at(-1) !== end && reduced.length > 0) reduced.push(end);
  return reduced.slice(0, MAX_STROKE);
}

/** Maximum number of points of a brush stroke that the protocol accepts. */
const MAX_STROKE = 2000;
