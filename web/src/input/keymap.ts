/** Every key, once: the listener, the key card and the tooltips all read this table. */

export type HoldAxis = "advance" | "roll" | "pitch" | "yaw";

export type Action =
  | "auto_advance"
  | "previous_fork"
  | "way_left"
  | "way_right"
  | "toggle_mode"
  | "join_pen"
  | "level_horizon"
  | "flip_operator"
  | "reset_look"
  | "crosshair_to_tip"
  | "wall_point"
  | "swap_outside"
  | "next_xray"
  | "next_cut"
  | "toggle_tone"
  | "next_slab"
  | "toggle_shape"
  | "toggle_outline"
  | "toggle_route_line"
  | "arm_target"
  | "arm_root"
  | "tool_add"
  | "tool_bridge"
  | "tool_cut"
  | "tool_fork"
  | "tool_smooth"
  | "tool_paint"
  | "tool_erase"
  | "tool_reroot"
  | "rename"
  | "brush_smaller"
  | "brush_larger"
  | "find_branch"
  | "window_airway"
  | "window_lung"
  | "window_mediastinum"
  | "window_bone"
  | "undo"
  | "redo"
  | "add_key"
  | "key_frames"
  | "lock_mouse"
  | "devices"
  | "key_card"
  | "leave";

export type Command = { kind: "hold"; axis: HoldAxis; sign: 1 | -1 } | { kind: "press"; action: Action };

export type KeyGroup = "Fly" | "Look" | "Plan" | "Airways" | "Pictures" | "Help";

export interface Binding {
  /** `KeyboardEvent.key`, letters in lower case: the letter that is printed on the key, on any layout. */
  readonly key: string;
  readonly ctrl?: boolean;
  /** Only told apart where it matters; Shift with a held key means slow. */
  readonly shift?: boolean;
  readonly label: string;
  readonly words: string;
  readonly group: KeyGroup;
  readonly command: Command;
}

const hold = (axis: HoldAxis, sign: 1 | -1): Command => ({ kind: "hold", axis, sign });
const press = (action: Action): Command => ({ kind: "press", action });

export const KEYMAP: readonly Binding[] = [
  { key: "w", label: "W", words: "Advance (hold; with Shift slowly)", group: "Fly", command: hold("advance", 1) },
  { key: "s", label: "S", words: "Withdraw", group: "Fly", command: hold("advance", -1) },
  {
    key: " ",
    label: "Space",
    words: "Advance to the next fork and stop there; again: stop",
    group: "Fly",
    command: press("auto_advance"),
  },
  {
    key: "Backspace",
    label: "Backspace",
    words: "Back to the fork before",
    group: "Fly",
    command: press("previous_fork"),
  },
  {
    key: "ArrowLeft",
    label: "\u2190",
    words: "Path: take the way further left. Free: look left",
    group: "Fly",
    command: press("way_left"),
  },
  {
    key: "ArrowRight",
    label: "\u2192",
    words: "Path: take the way further right. Free: look right",
    group: "Fly",
    command: press("way_right"),
  },
  {
    key: "m",
    shift: false,
    label: "M",
    words: "Free, or along the path; with a device: absolute, relative, path",
    group: "Fly",
    command: press("toggle_mode"),
  },
  {
    key: "m",
    shift: true,
    label: "Shift+M",
    words: "Absolute: bring the tip to the pen at once",
    group: "Fly",
    command: press("join_pen"),
  },
  {
    key: "Enter",
    ctrl: true,
    label: "Ctrl+Enter",
    words: "Lock the mouse to the airway picture: it turns the tip (Esc frees it)",
    group: "Fly",
    command: press("lock_mouse"),
  },
  {
    key: ".",
    label: ".",
    words: "Add a key frame: this view becomes a stop of the flight",
    group: "Fly",
    command: press("add_key"),
  },
  {
    key: ",",
    label: ",",
    words: "Key frames: list, flight, speed, file",
    group: "Fly",
    command: press("key_frames"),
  },
  { key: ";", label: ";", words: "Input devices", group: "Fly", command: press("devices") },
  { key: "ArrowUp", label: "\u2191", words: "Tip up", group: "Look", command: hold("pitch", 1) },
  { key: "ArrowDown", label: "\u2193", words: "Tip down", group: "Look", command: hold("pitch", -1) },
  { key: "a", label: "A", words: "Roll to the left", group: "Look", command: hold("roll", -1) },
  { key: "d", label: "D", words: "Roll to the right", group: "Look", command: hold("roll", 1) },
  { key: "h", label: "H", words: "Level the horizon", group: "Look", command: press("level_horizon") },
  {
    key: "f",
    label: "F",
    words: "Operator at the head end, or facing the patient",
    group: "Look",
    command: press("flip_operator"),
  },
  { key: "r", label: "R", words: "Look straight along the path again", group: "Look", command: press("reset_look") },
  {
    key: "n",
    label: "N",
    words: "New target: the next click in a picture marks it",
    group: "Plan",
    command: press("arm_target"),
  },
  {
    key: "b",
    shift: false,
    label: "B",
    words: "Find the airways again from the next click",
    group: "Airways",
    command: press("arm_root"),
  },
  {
    key: "j",
    label: "J",
    words: "Add a branch: the next clicks are ends of airways",
    group: "Airways",
    command: press("tool_add"),
  },
  { key: "l", label: "L", words: "Bridge a blockage", group: "Airways", command: press("tool_bridge") },
  { key: "k", label: "K", words: "Cut a branch", group: "Airways", command: press("tool_cut") },
  { key: "y", label: "Y", words: "Move a fork", group: "Airways", command: press("tool_fork") },
  { key: "u", label: "U", words: "Smooth a branch", group: "Airways", command: press("tool_smooth") },
  {
    key: "q",
    shift: false,
    label: "Q",
    words: "Paint lumen in a slice",
    group: "Airways",
    command: press("tool_paint"),
  },
  {
    key: "q",
    shift: true,
    label: "Shift+Q",
    words: "Erase lumen in a slice",
    group: "Airways",
    command: press("tool_erase"),
  },
  { key: "[", label: "[", words: "Smaller brush", group: "Airways", command: press("brush_smaller") },
  { key: "]", label: "]", words: "Larger brush", group: "Airways", command: press("brush_larger") },
  {
    key: "b",
    shift: true,
    label: "Shift+B",
    words: "Move the root, keep the tree",
    group: "Airways",
    command: press("tool_reroot"),
  },
  { key: "F2", label: "F2", words: "Rename the chosen branch", group: "Airways", command: press("rename") },
  { key: "/", label: "/", words: "Search the list of branches", group: "Airways", command: press("find_branch") },
  { key: "z", ctrl: true, shift: false, label: "Ctrl+Z", words: "Undo", group: "Plan", command: press("undo") },
  { key: "z", ctrl: true, shift: true, label: "Ctrl+Shift+Z", words: "Redo", group: "Plan", command: press("redo") },
  { key: "c", label: "C", words: "Crosshair back to the tip", group: "Pictures", command: press("crosshair_to_tip") },
  {
    key: "e",
    label: "E",
    words: "Wall in the middle of the airway view: place, distance, HU (or click the wall; Esc takes the marks away)",
    group: "Pictures",
    command: press("wall_point"),
  },
  { key: "t", label: "T", words: "Airway tree, or tri-plane", group: "Pictures", command: press("swap_outside") },
  {
    key: "x",
    label: "X",
    words: "X-ray from the next side, or from the C-arm",
    group: "Pictures",
    command: press("next_xray"),
  },
  {
    key: "g",
    label: "G",
    words: "C-arm picture as radiograph, or as fluoroscopy",
    group: "Pictures",
    command: press("toggle_tone"),
  },
  {
    key: "v",
    label: "V",
    words: "Cut-plane, straightened airway, or curved reformation",
    group: "Pictures",
    command: press("next_cut"),
  },
  {
    key: "i",
    label: "I",
    words: "Slices thin, or thick: minimum (airways), maximum, mean",
    group: "Pictures",
    command: press("next_slab"),
  },
  {
    key: "o",
    shift: false,
    label: "O",
    words: "Airway picture round, or the full frame",
    group: "Pictures",
    command: press("toggle_shape"),
  },
  {
    key: "o",
    shift: true,
    label: "Shift+O",
    words: "Show or hide the outline of the lumen and the centrelines in slices",
    group: "Pictures",
    command: press("toggle_outline"),
  },
  {
    key: "p",
    label: "P",
    words: "Show or hide the line of the route",
    group: "Pictures",
    command: press("toggle_route_line"),
  },
  { key: "1", label: "1", words: "Lung window (W 1500 L \u2212600)", group: "Pictures", command: press("window_lung") },
  {
    key: "2",
    label: "2",
    words: "Mediastinum window (W 400 L 40)",
    group: "Pictures",
    command: press("window_mediastinum"),
  },
  { key: "3", label: "3", words: "Bone window (W 2000 L 500)", group: "Pictures", command: press("window_bone") },
  {
    key: "0",
    label: "0",
    words: "Airway window (W 1000 L \u2212700)",
    group: "Pictures",
    command: press("window_airway"),
  },
  { key: "?", label: "?", words: "This card", group: "Help", command: press("key_card") },
  {
    key: "Escape",
    label: "Esc",
    words: "Put the tool away; then leave the full view; then remove the wall marks",
    group: "Help",
    command: press("leave"),
  },
];

export const WINDOWS = {
  window_airway: { width_hu: 1000, level_hu: -700 },
  window_lung: { width_hu: 1500, level_hu: -600 },
  window_mediastinum: { width_hu: 400, level_hu: 40 },
  window_bone: { width_hu: 2000, level_hu: 500 },
} as const;

/** The printed key of an action, for tooltips. */
export function keyOf(action: Action): string {
  return KEYMAP.find((b) => b.command.kind === "press" && b.command.action === action)?.label ?? "";
}

export interface KeyPress {
  readonly key: string;
  readonly ctrlKey: boolean;
  readonly metaKey: boolean;
  readonly altKey: boolean;
  readonly shiftKey: boolean;
}

/** The binding of a key press, or null: then the key belongs to the browser and is not touched. */
export function bindingOf(event: KeyPress): Binding | null {
  if (event.altKey) return null;
  const ctrl = event.ctrlKey || event.metaKey;
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  return (
    KEYMAP.find(
      (b) => b.key === key && (b.ctrl ?? false) === ctrl && (b.shift === undefined || b.shift === event.shiftKey),
    ) ?? null
  );
}

/** What has the focus, as far as keys care. */
export type FocusKind = "page" | "typing" | "arrows" | "button";

/** Keys that a focused list, tree or slider needs for itself. */
const ARROW_KEYS = new Set(["ArrowUp", "ArrowDown", "ArrowLeft", "ArrowRight", " ", "Backspace", "Escape"]);
const BUTTON_KEYS = new Set([" "]);

/** Whether the flight takes a key while something has the focus. Typing keeps every key; a button keeps its space bar. */
export function takesKey(focus: FocusKind, key: string): boolean {
  switch (focus) {
    case "page":
      return true;
    case "typing":
      return false;
    case "arrows":
      return !ARROW_KEYS.has(key);
    case "button":
      return !BUTTON_KEYS.has(key);
  }
}
