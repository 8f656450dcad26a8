/** Recognition of clicks, drags and wheel turns on a picture, shared by all views. */

import { ClickCounter, type PointerPlace } from "./clicks";

export type { PointerPlace } from "./clicks";

/** Kind of a drag, by its mouse button and Shift. */
export type DragButton = "main" | "window" | "pan";

/** Callbacks of the pointer listener of a view. */
export interface PointerHandlers {
  /** Return whether drags with the middle button, or with Shift, pan; in other views Shift has no effect. */
  pans?(): boolean;
  /** Handle a press of the main button without movement; `count` is 2 for the second click of a double click. */
  click?(at: PointerPlace, count: number): void;
  /** Handle a press of the right button without movement. */
  secondaryClick?(at: PointerPlace): void;
  /** Handle a drag; `byFinger` is true for one finger on a touch screen. */
  drag?(at: PointerPlace, moved: { dx: number; dy: number }, button: DragButton, byFinger: boolean): void;
  /** Handle the release of the button at the end of a drag. */
  release?(): void;
  /**
   * Handle movement without a pressed button; a null `at` means that the pointer has left the picture. With `shift` the
   * crosshair follows the pointer.
   */
  hover?(at: PointerPlace | null, shift: boolean): void;
  wheel?(deltaPx: number, zoom: boolean, at: PointerPlace): void;
}

/** Movement of the pointer, px, up to which a press counts as a click and not as a drag. */
const CLICK_PX = 3;
/** Scrolling by one line of a wheel that counts in lines, px. */
const LINE_PX = 16;

/** Return the middle and the distance of two fingers; null for one finger. */
function pairOf(fingers: ReadonlyMap<number, PointerPlace>): { middle: PointerPlace; apart: number } | null {
  const [a, b] = [...fingers.values()];
  if (a === undefined || b === undefined) return null;
  return { middle: { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2 }, apart: Math.hypot(a.x - b.x, a.y - b.y) };
}

/** Natural logarithm of the zoom factor per px of scrolling, as views apply it to a wheel. */
export const ZOOM_PER_PX = 0.0015;
/** Minimum distance of two fingers, px: below it, a small movement would zoom by a large factor. */
const LEAST_APART_PX = 24;

/** Return the scrolling, px, that zooms by the ratio of two distances between fingers; below 0 for spread fingers. */
export function pinchScrollPx(beforePx: number, afterPx: number): number {
  const before = Math.max(beforePx, LEAST_APART_PX);
  const after = Math.max(afterPx, LEAST_APART_PX);
  return -Math.log(after / before) / ZOOM_PER_PX;
}

function buttonOf(event: PointerEvent, pans: boolean): DragButton | null {
  if (event.button === 2) return "window";
  if (event.button === 1) return pans ? "pan" : null;
  if (event.button !== 0) return null;
  return pans && event.shiftKey ? "pan" : "main";
}

/** Add the pointer listener to the element of a picture; return a function that removes it. */
export function listenToPointer(element: HTMLElement, handlers: PointerHandlers): () => void {
  let drag: { id: number; x: number; y: number; button: DragButton; clicks: boolean; moved: boolean } | null = null;
  /** Fingers that touch the element, with their positions; two of them zoom and pan. */
  const fingers = new Map<number, PointerPlace>();
  /**
   * Whether a click event of the browser follows the release of the mouse button; the event has the number of the click
   * in its series.
   */
  let clickFollows = false;
  const clicks = new ClickCounter();

  const place = (event: MouseEvent): PointerPlace => {
    const box = element.getBoundingClientRect();
    return { x: event.clientX - box.left, y: event.clientY - box.top };
  };
  /** Handle a movement of one of two fingers: pan by the movement of their middle, zoom by their distance. */
  const moveTwo = (event: PointerEvent) => {
    const before = pairOf(fingers);
    fingers.set(event.pointerId, place(event));
    const after = pairOf(fingers);
    if (before === null || after === null) return;
    const zoom = pinchScrollPx(before.apart, after.apart);
    if (zoom !== 0) handlers.wheel?.(zoom, true, after.middle);
    if (!(handlers.pans?.() ?? false)) return;
    const moved = { dx: after.middle.x - before.middle.x, dy: after.middle.y - before.middle.y };
    if (moved.dx !== 0 || moved.dy !== 0) handlers.drag?.(after.middle, moved, "pan", false);
  };
  const down = (event: PointerEvent) => {
    if (event.pointerType === "touch" && fingers.size < 2) fingers.set(event.pointerId, place(event));
    if (fingers.size === 2) {
      // A second finger ends the drag of the first one, which must not act as a click either.
      if (drag !== null) handlers.release?.();
      drag = null;
      clicks.forget();
      element.setPointerCapture(event.pointerId);
      return;
    }
    const button = buttonOf(event, handlers.pans?.() ?? false);
    clickFollows = false;
    if (drag !== null || button === null) return;
    drag = {
      id: event.pointerId,
      x: event.clientX,
      y: event.clientY,
      button,
      clicks: event.button === 0,
      moved: false,
    };
    element.setPointerCapture(event.pointerId);
  };
  const move = (event: PointerEvent) => {
    if (fingers.size === 2 && fingers.has(event.pointerId)) {
      moveTwo(event);
      return;
    }
    if (fingers.has(event.pointerId)) fingers.set(event.pointerId, place(event));
    if (drag === null) {
      handlers.hover?.(place(event), event.shiftKey);
      return;
    }
    if (event.pointerId !== drag.id) return;
    const dx = event.clientX - drag.x;
    const dy = event.clientY - drag.y;
    if (!drag.moved && Math.hypot(dx, dy) < CLICK_PX) return;
    drag = { ...drag, moved: true, x: event.clientX, y: event.clientY };
    handlers.drag?.(place(event), { dx, dy }, drag.button, event.pointerType === "touch");
  };
  const up = (event: PointerEvent) => {
    const wasPinch = fingers.size === 2 && fingers.delete(event.pointerId);
    fingers.delete(event.pointerId);
    if (wasPinch) handlers.release?.();
    if (drag === null || event.pointerId !== drag.id) return;
    const wasClick = !drag.moved && event.type === "pointerup";
    const held = drag;
    drag = null;
    if (!wasClick || !held.clicks) {
      clicks.forget();
      handlers.release?.();
      if (wasClick && held.button === "window") handlers.secondaryClick?.(place(event));
    } else if (event.pointerType === "mouse") clickFollows = true;
    // Count the clicks of touch and pen here, because some browsers do not. Mouse clicks are counted by the browser
    // with the settings of the system.
    else handlers.click?.(place(event), clicks.count(place(event), event.timeStamp, "finger"));
  };
  const click = (event: MouseEvent) => {
    if (!clickFollows) return;
    clickFollows = false;
    handlers.click?.(place(event), Math.max(event.detail, 1));
  };
  const leave = () => handlers.hover?.(null, false);
  const wheel = (event: WheelEvent) => {
    if (handlers.wheel === undefined) return;
    event.preventDefault();
    const unit = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? LINE_PX : 1;
    handlers.wheel(event.deltaY * unit, event.ctrlKey || event.metaKey, place(event));
  };
  const nothing = (event: Event) => event.preventDefault();
  // Prevent the browser's automatic scrolling, which the middle button starts.
  const middle = (event: MouseEvent) => {
    if (event.button === 1) event.preventDefault();
  };

  element.addEventListener("pointerdown", down);
  element.addEventListener("pointermove", move);
  element.addEventListener("pointerup", up);
  element.addEventListener("pointercancel", up);
  element.addEventListener("pointerleave", leave);
  element.addEventListener("wheel", wheel, { passive: false });
  element.addEventListener("click", click);
  element.addEventListener("dblclick", nothing);
  element.addEventListener("contextmenu", nothing);
  element.addEventListener("mousedown", middle);
  return () => {
    element.removeEventListener("pointerdown", down);
    element.removeEventListener("pointermove", move);
    element.removeEventListener("pointerup", up);
    element.removeEventListener("pointercancel", up);
    element.removeEventListener("pointerleave", leave);
    element.removeEventListener("wheel", wheel);
    element.removeEventListener("click", click);
    element.removeEventListener("dblclick", nothing);
    element.removeEventListener("contextmenu", nothing);
    element.removeEventListener("mousedown", middle);
  };
}
