/** Last use of pointer or keyboard on the page; it distinguishes a choice from a movement of the keyboard focus. */

let lastKind: "mouse" | "finger" | "key" = "mouse";
let lastKey = "";

/** Keys that choose the focused row of a list; all other keys only move the focus. */
const CHOOSING_KEYS: readonly string[] = ["Enter", " "];

if (typeof window !== "undefined") {
  const options = { capture: true } as const;
  window.addEventListener(
    "pointerdown",
    ({ pointerType }) => {
      lastKind = pointerType === "mouse" ? "mouse" : "finger";
    },
    options,
  );
  window.addEventListener(
    "keydown",
    ({ key }) => {
      lastKind = "key";
      lastKey = key;
    },
    options,
  );
  window.addEventListener(
    "click",
    ({ detail }) => {
      // A screen reader clicks without a pointer and without a key.
      if (detail === 0 && !(lastKind === "key" && CHOOSING_KEYS.includes(lastKey))) lastKind = "finger";
    },
    options,
  );
}

/** Return whether the last input was a pointer (mouse, finger, pen), not a key. */
export const wasPointer = (): boolean => lastKind !== "key";

/** Return whether the last input was a finger or a pen, which is less exact than a mouse. */
export const wasFinger = (): boolean => lastKind === "finger";

/** Return whether the last input was the mouse. */
export const wasMouse = (): boolean => lastKind === "mouse";

/** Return whether the last input only moved the keyboard focus, for example Tab or an arrow key. */
export const movedFocus = (): boolean => lastKind === "key" && !CHOOSING_KEYS.includes(lastKey);
