/**
 * Table of keys and mouse gestures: the effect of each, the place where it is valid, and its text. The listeners, the
 * key card, the tooltips and the list in docs/keys.md read the table (decision 0102).
 */

/** Movement of the tip by a held key. */
export type HoldAxis = "advance" | "roll" | "pitch" | "yaw";

/** Action that a pressed key runs. */
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
  | "full_screen"
  | "toggle_outline"
  | "toggle_route_line"
  | "save_picture"
  | "save_video"
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
  | "save"
  | "history"
  | "add_key"
  | "key_frames"
  | "lock_mouse"
  | "devices"
  | "key_card"
  | "leave"
  | "pause_task";

/** Gesture of a key in a focused view; each kind of view interprets it. */
export type PictureGesture =
  | { readonly gesture: "enter" }
  | { readonly gesture: "fit" }
  | { readonly gesture: "zoom" | "scroll"; readonly sign: 1 | -1 }
  | { readonly gesture: "move" | "pan"; readonly right: number; readonly down: number };

/** Effect of a key: a movement, an action, or a gesture in the focused view. */
export type Command =
  | { readonly kind: "hold"; readonly axis: HoldAxis; readonly sign: 1 | -1 }
  | { readonly kind: "press"; readonly action: Action }
  | { readonly kind: "picture"; readonly does: PictureGesture }
  /** Marks a key that the focused element (list, field, dialog) handles itself; the table only contains its text. */
  | { readonly kind: "own" };

/**
 * Contexts in which a key is valid, with titles. Several can apply at once: an active brush, a focused slice, the page.
 */
export const PLACES = {
  page: { title: "Anywhere", within: null, over: [] },
  brush: { title: "With a brush selected", within: null, over: [] },
  task: { title: "During a task of the training", within: null, over: ["page", "brush"] },
  picture: { title: "Any view with focus", within: null, over: [] },
  plane: { title: "Slices and cut-plane", within: "picture", over: [] },
  path: { title: "Straightened and curved views", within: "picture", over: [] },
  carm: { title: "X-ray from the C-arm", within: "picture", over: [] },
  orbit: { title: "Airway tree and tri-plane", within: "picture", over: [] },
  "tri-plane": { title: "Tri-plane", within: "orbit", over: [] },
  question: { title: "While a question is open", within: null, over: ["picture"] },
  list: { title: "Lists, sliders and tabs", within: null, over: ["page", "question"] },
  button: { title: "Buttons", within: null, over: ["page", "question"] },
  field: { title: "Text fields", within: null, over: ["page", "brush", "question"] },
  dialog: { title: "Dialogs", within: null, over: ["page", "brush", "question"] },
} as const satisfies Record<string, { title: string; within: string | null; over: readonly string[] }>;
/** Name of a context in which a key is valid. */
export type KeyPlace = keyof typeof PLACES;

/** Title of a group of keys on the key card. */
export type KeyGroup = "Fly" | "Look" | "Plan" | "Airways" | "Views" | "Help";

/** Key with its context, its action and its explanation. */
export interface Binding {
  readonly place: KeyPlace;
  /** `KeyboardEvent.key` with letters in lower case: the printed letter on any keyboard layout. */
  readonly key: string;
  readonly ctrl?: boolean;
  /**
   * State of Shift that the binding requires; absent if the binding does not depend on Shift. With a held movement key,
   * Shift selects the slow speed.
   */
  readonly shift?: boolean;
  readonly label: string;
  readonly words: string;
  /** Group on the key card of a key that is valid anywhere. */
  readonly group?: KeyGroup;
  readonly command: Command;
}

const hold = (axis: HoldAxis, sign: 1 | -1): Command => ({ kind: "hold", axis, sign });
const press = (action: Action): Command => ({ kind: "press", action });
const OWN: Command = { kind: "own" };

/** Keys with one action in several directions, listed in one line of the key card. */
interface Keys {
  readonly ctrl?: boolean;
  readonly shift?: boolean;
  readonly label: string;
  readonly does: Readonly<Record<string, PictureGesture>>;
}

const arrows = (gesture: "move" | "pan"): Keys["does"] => ({
  ArrowLeft: { gesture, right: -1, down: 0 },
  ArrowRight: { gesture, right: 1, down: 0 },
  ArrowUp: { gesture, right: 0, down: -1 },
  ArrowDown: { gesture, right: 0, down: 1 },
});

/** The Enter key, which is valid in every view; each kind of view has its own text for it. */
const ENTER: Keys = { label: "Enter", ctrl: false, does: { Enter: { gesture: "enter" } } };
const FIT: Keys = { label: "Home", ctrl: false, does: { Home: { gesture: "fit" } } };
const ZOOM: Keys = {
  label: "+  \u2212",
  ctrl: false,
  does: { "+": { gesture: "zoom", sign: 1 }, "=": { gesture: "zoom", sign: 1 }, "-": { gesture: "zoom", sign: -1 } },
};
const SCROLL: Keys = {
  label: "PgUp  PgDn",
  ctrl: false,
  does: { PageUp: { gesture: "scroll", sign: 1 }, PageDown: { gesture: "scroll", sign: -1 } },
};
const MOVE: Keys = { label: "Shift+arrow keys", ctrl: false, shift: true, does: arrows("move") };
const PAN: Keys = { label: "Ctrl+arrow keys", ctrl: true, does: arrows("pan") };

function inPicture(place: KeyPlace, keys: Keys, words: string): Binding[] {
  const { label, does, ...modifiers } = keys;
  return Object.entries(does).map(([key, what]) => ({
    place,
    key,
    ...modifiers,
    label,
    words,
    command: { kind: "picture", does: what },
  }));
}

const own = (place: KeyPlace, label: string, words: string, ...keys: readonly string[]): Binding[] =>
  keys.map((key) => ({ place, key, label, words, command: OWN }));

const PAGE: readonly Binding[] = [
  {
    place: "page",
    key: "w",
    label: "W",
    words: "Advance (hold; Shift: slow)",
    group: "Fly",
    command: hold("advance", 1),
  },
  { place: "page", key: "s", label: "S", words: "Withdraw", group: "Fly", command: hold("advance", -1) },
  {
    place: "page",
    key: " ",
    label: "Space",
    words: "Fly to the next fork and stop there; press again to stop earlier",
    group: "Fly",
    command: press("auto_advance"),
  },
  {
    place: "page",
    key: "Backspace",
    label: "Backspace",
    words: "Back to the previous fork",
    group: "Fly",
    command: press("previous_fork"),
  },
  {
    place: "page",
    key: "ArrowLeft",
    shift: false,
    label: "\u2190",
    words: "Path: choose the next branch to the left. Free: look left",
    group: "Fly",
    command: press("way_left"),
  },
  {
    place: "page",
    key: "ArrowRight",
    shift: false,
    label: "\u2192",
    words: "Path: choose the next branch to the right. Free: look right",
    group: "Fly",
    command: press("way_right"),
  },
  {
    place: "page",
    key: "m",
    shift: false,
    label: "M",
    words: "Switch between free and path movement; with a device: absolute, relative or path",
    group: "Fly",
    command: press("toggle_mode"),
  },
  {
    place: "page",
    key: "m",
    shift: true,
    label: "Shift+M",
    words: "Absolute mode: move the tip to the pen now",
    group: "Fly",
    command: press("join_pen"),
  },
  {
    place: "page",
    key: "Enter",
    ctrl: true,
    label: "Ctrl+Enter",
    words: "Lock the mouse to the airway view to steer the tip (Esc releases it)",
    group: "Fly",
    command: press("lock_mouse"),
  },
  {
    place: "page",
    key: ".",
    label: ".",
    words: "Add the current view as a key frame",
    group: "Fly",
    command: press("add_key"),
  },
  {
    place: "page",
    key: ",",
    label: ",",
    words: "Open or close the key frames panel",
    group: "Fly",
    command: press("key_frames"),
  },
  {
    place: "page",
    key: ";",
    label: ";",
    words: "Open or close the devices panel",
    group: "Fly",
    command: press("devices"),
  },
  {
    place: "page",
    key: "ArrowUp",
    shift: false,
    label: "\u2191",
    words: "Tip up",
    group: "Look",
    command: hold("pitch", 1),
  },
  {
    place: "page",
    key: "ArrowDown",
    shift: false,
    label: "\u2193",
    words: "Tip down",
    group: "Look",
    command: hold("pitch", -1),
  },
  { place: "page", key: "a", label: "A", words: "Roll to the left", group: "Look", command: hold("roll", -1) },
  { place: "page", key: "d", label: "D", words: "Roll to the right", group: "Look", command: hold("roll", 1) },
  {
    place: "page",
    key: "h",
    shift: false,
    label: "H",
    words: "Level the horizon",
    group: "Look",
    command: press("level_horizon"),
  },
  {
    place: "page",
    key: "f",
    shift: false,
    label: "F",
    words: "Switch the operator between the head end and facing the patient",
    group: "Look",
    command: press("flip_operator"),
  },
  {
    place: "page",
    key: "r",
    label: "R",
    words: "Look straight along the path again",
    group: "Look",
    command: press("reset_look"),
  },
  {
    place: "page",
    key: "n",
    label: "N",
    words: "Mark a target: click it in a view",
    group: "Plan",
    command: press("arm_target"),
  },
  {
    place: "page",
    key: "b",
    shift: false,
    label: "B",
    words: "Re-segment the airways from a point you click",
    group: "Airways",
    command: press("arm_root"),
  },
  {
    place: "page",
    key: "j",
    label: "J",
    words: "Add branches: click the distal ends of missing airways",
    group: "Airways",
    command: press("tool_add"),
  },
  {
    place: "page",
    key: "l",
    label: "L",
    words: "Bridge an obstruction",
    group: "Airways",
    command: press("tool_bridge"),
  },
  { place: "page", key: "k", label: "K", words: "Cut a branch", group: "Airways", command: press("tool_cut") },
  { place: "page", key: "y", label: "Y", words: "Move a fork", group: "Airways", command: press("tool_fork") },
  { place: "page", key: "u", label: "U", words: "Smooth a branch", group: "Airways", command: press("tool_smooth") },
  {
    place: "page",
    key: "q",
    shift: false,
    label: "Q",
    words: "Paint lumen in a slice",
    group: "Airways",
    command: press("tool_paint"),
  },
  {
    place: "page",
    key: "q",
    shift: true,
    label: "Shift+Q",
    words: "Erase lumen in a slice",
    group: "Airways",
    command: press("tool_erase"),
  },
  { place: "task", key: "z", label: "Z", words: "Pause the task, or continue it", command: press("pause_task") },
  { place: "brush", key: "[", label: "[", words: "Smaller brush", command: press("brush_smaller") },
  { place: "brush", key: "]", label: "]", words: "Larger brush", command: press("brush_larger") },
  {
    place: "page",
    key: "b",
    shift: true,
    label: "Shift+B",
    words: "Set the start point; the tree is kept",
    group: "Airways",
    command: press("tool_reroot"),
  },
  {
    place: "page",
    key: "F2",
    label: "F2",
    words: "Rename the selected branch",
    group: "Airways",
    command: press("rename"),
  },
  {
    place: "page",
    key: "/",
    label: "/",
    words: "Search the list of branches; Enter chooses the exact name, else the first match",
    group: "Airways",
    command: press("find_branch"),
  },
  {
    place: "page",
    key: "z",
    ctrl: true,
    shift: false,
    label: "Ctrl+Z",
    words: "Undo",
    group: "Plan",
    command: press("undo"),
  },
  {
    place: "page",
    key: "z",
    ctrl: true,
    shift: true,
    label: "Ctrl+Shift+Z",
    words: "Redo",
    group: "Plan",
    command: press("redo"),
  },
  {
    place: "page",
    key: "s",
    ctrl: true,
    shift: false,
    label: "Ctrl+S",
    words: "Save a named copy of the case, or update it",
    group: "Plan",
    command: press("save"),
  },
  {
    place: "page",
    key: "h",
    shift: true,
    label: "Shift+H",
    words: "Edit history: return to any step",
    group: "Plan",
    command: press("history"),
  },
  {
    place: "page",
    key: "c",
    label: "C",
    words: "Move the crosshair back to the tip",
    group: "Views",
    command: press("crosshair_to_tip"),
  },
  {
    place: "page",
    key: "e",
    label: "E",
    words:
      "Mark the wall at the centre of the airway view (or click the wall) to read its position and HU. Two marks give their distance; Esc removes them",
    group: "Views",
    command: press("wall_point"),
  },
  {
    place: "page",
    key: "t",
    label: "T",
    words: "Switch between airway tree and tri-plane (a wide window shows both)",
    group: "Views",
    command: press("swap_outside"),
  },
  {
    place: "page",
    key: "x",
    label: "X",
    words: "Next X-ray: AP, lateral, axial, then C-arm",
    group: "Views",
    command: press("next_xray"),
  },
  {
    place: "page",
    key: "g",
    label: "G",
    words: "Switch the C-arm view between radiograph and fluoroscopy",
    group: "Views",
    command: press("toggle_tone"),
  },
  {
    place: "page",
    key: "v",
    shift: true,
    label: "Shift+V",
    words: "Save the flight along the route as a video",
    group: "Views",
    command: press("save_video"),
  },
  {
    place: "page",
    key: "v",
    shift: false,
    label: "V",
    words: "Switch between cut-plane, straightened airway and curved reformation",
    group: "Views",
    command: press("next_cut"),
  },
  {
    place: "page",
    key: "i",
    label: "I",
    words: "Slab: off / MinIP / MIP / mean",
    group: "Views",
    command: press("next_slab"),
  },
  {
    place: "page",
    key: "o",
    shift: false,
    label: "O",
    words: "Airway view: round or full frame",
    group: "Views",
    command: press("toggle_shape"),
  },
  {
    place: "page",
    key: "f",
    shift: true,
    label: "Shift+F",
    words: "Airway view alone on the whole screen, and back",
    group: "Views",
    command: press("full_screen"),
  },
  {
    place: "page",
    key: "o",
    shift: true,
    label: "Shift+O",
    words: "Show or hide the lumen outline and the centrelines in slices",
    group: "Views",
    command: press("toggle_outline"),
  },
  {
    place: "page",
    key: "p",
    shift: false,
    label: "P",
    words: "Show or hide the route line",
    group: "Views",
    command: press("toggle_route_line"),
  },
  {
    place: "page",
    key: "p",
    shift: true,
    label: "Shift+P",
    words: "Save a picture of the focused view, else of the full view or the airway view",
    group: "Views",
    command: press("save_picture"),
  },
  {
    place: "page",
    key: "1",
    label: "1",
    words: "Lung window (W 1500 L \u2212600)",
    group: "Views",
    command: press("window_lung"),
  },
  {
    place: "page",
    key: "2",
    label: "2",
    words: "Mediastinum window (W 400 L 40)",
    group: "Views",
    command: press("window_mediastinum"),
  },
  {
    place: "page",
    key: "3",
    label: "3",
    words: "Bone window (W 2000 L 500)",
    group: "Views",
    command: press("window_bone"),
  },
  {
    place: "page",
    key: "0",
    label: "0",
    words: "Airway window (W 1000 L \u2212700)",
    group: "Views",
    command: press("window_airway"),
  },
  { place: "page", key: "?", label: "?", words: "Show this list of keys", group: "Help", command: press("key_card") },
  {
    place: "page",
    key: "Escape",
    label: "Esc",
    words: "Cancel the current tool, or exit full view, or remove the wall marks",
    group: "Help",
    command: press("leave"),
  },
];

const IN_PLACES: readonly Binding[] = [
  ...inPicture("picture", ENTER, "Maximise or restore the view; with a tool selected, use it at the crosshair"),
  ...inPicture("plane", SCROLL, "Previous slice, next slice"),
  ...inPicture("plane", MOVE, "Move the crosshair by 1 mm"),
  ...inPicture("plane", PAN, "Pan"),
  ...inPicture("plane", ZOOM, "Zoom"),
  ...inPicture("plane", FIT, "Fit the slice; in the cut-plane, go back to the tip"),
  ...inPicture("path", MOVE, "Turn the plane about the path; move 2 mm along the path"),
  ...inPicture("path", ZOOM, "Zoom"),
  ...inPicture("path", FIT, "Fit the whole route"),
  ...inPicture("carm", MOVE, "Turn the C-arm by 5\u00b0"),
  ...inPicture("carm", ZOOM, "Zoom"),
  ...inPicture("carm", FIT, "Back to the AP view"),
  ...inPicture("orbit", MOVE, "Turn the view by 5\u00b0"),
  ...inPicture("orbit", ZOOM, "Zoom in, zoom out"),
  ...inPicture("orbit", FIT, "Back to the front view"),
  ...inPicture("tri-plane", SCROLL, "Move the axial plane up or down by 1 mm"),
  ...inPicture("tri-plane", PAN, "Move the sagittal plane left or right, the coronal plane back or forward, by 1 mm"),
  ...own("question", "Enter", "Draw the branch anyway (Esc: cancel)", "Enter"),
  ...own(
    "list",
    "Arrows",
    "Move through the list; expand or collapse a branch",
    "ArrowUp",
    "ArrowDown",
    "ArrowLeft",
    "ArrowRight",
  ),
  ...own("list", "Enter, Space", "Choose", "Enter", " "),
  ...own("list", "Bksp, Esc", "No effect here, so that the tip is not moved by mistake", "Backspace", "Escape"),
  ...own("button", "Enter, Space", "Press the button", "Enter", " "),
  ...own("field", "Enter", "Accept the entry", "Enter"),
  ...own("field", "Esc", "Cancel the entry", "Escape"),
  ...own("dialog", "Esc", "Close the dialog", "Escape"),
];

/** All key bindings: those of the page first, then those of single places. */
export const KEYMAP: readonly Binding[] = [...PAGE, ...IN_PLACES];

/** Texts about the mouse for the key card. The gestures of the views implement the effects. */
export const MOUSE: readonly { readonly where: string; readonly what: readonly (readonly [string, string])[] }[] = [
  {
    where: "Airway view",
    what: [
      ["Drag", "look around"],
      ["Wheel", "advance and withdraw"],
      ["Click", "mark the wall; with a tool selected, use it there"],
    ],
  },
  {
    where: "Slices",
    what: [
      ["Click, drag, Shift + move", "move the crosshair"],
      ["Wheel", "previous or next slice; in the cut-plane, zoom"],
      ["Ctrl + wheel", "zoom"],
      ["Middle drag, Shift + drag", "pan"],
      ["Right drag", "window width (across) and level (up or down)"],
    ],
  },
  {
    where: "Straightened, curved",
    what: [
      ["Click", "go to that point on the route"],
      ["Drag", "turn the plane about the path"],
      ["Wheel", "zoom"],
    ],
  },
  {
    where: "X-ray from the C-arm",
    what: [
      ["Drag", "turn the C-arm"],
      ["Wheel", "zoom"],
    ],
  },
  {
    where: "Tree and tri-plane",
    what: [
      ["Drag", "turn the view; on a plane, move that plane"],
      ["Wheel", "zoom in, zoom out"],
      ["Click a branch", "choose the route to it"],
    ],
  },
  {
    where: "Any view",
    what: [
      ["Double-click", "full view and back"],
      ["Right click", "cancel the tool"],
    ],
  },
  {
    where: "Touch screen",
    what: [
      ["Tap", "choose a branch; in a slice, move the crosshair"],
      ["One finger in a slice", "scroll through the slices"],
      ["Two fingers in a slice", "zoom (apart or together) and pan"],
      ["Two fingers in the airway view", "advance (apart) and withdraw (together)"],
      ["Left stick", "advance and withdraw, roll"],
      ["Right stick", "look around, bend the scope"],
    ],
  },
];

/** Presets of the grey-value window, width and level in HU, by action. */
export const WINDOWS = {
  window_airway: { width_hu: 1000, level_hu: -700 },
  window_lung: { width_hu: 1500, level_hu: -600 },
  window_mediastinum: { width_hu: 400, level_hu: 40 },
  window_bone: { width_hu: 2000, level_hu: 500 },
} as const;
