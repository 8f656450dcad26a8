/** Clicks, drags and wheel turns on a picture, told apart once for all pictures. */

import { ClickCounter, type PointerPlace } from "./clicks";

export type { PointerPlace } from "./clicks";

export type DragButton = "main" | "window" | "pan";

export interface PointerHandlers {
  /** Drags with the middle button, or with Shift, are "pan"; elsewhere Shift changes nothing. */
  pans?(): boolean;
  /** A press that was let go without moving; `count` is 2 for the second of a double click. */
  click?(at: PointerPlace, count: number): void;
  /** The same with the right button. */
  secondaryClick?(at: PointerPlace): void;
  drag?(at: PointerPlace, moved: { dx: number; dy: number }, button: DragButton): void;
  /** A drag has ended. */
  release?(): void;
  /** The pointer passes; `shift` moves the crosshair along. */
  hover?(at: PointerPlace | null, shift: boolean): void;
  wheel?(deltaPx: number, zoom: boolean, at: PointerPlace): void;
}

/** A hand that clicks shakes by this much. */
const CLICK_PX = 3;
const LINE_PX = 16;

function buttonOf(event: PointerEvent, pans: boolean): DragButton | null {
  if (event.button === 2) return "window";
  if (event.button === 1) return pans ? "pan" : null;
  if (event.button !== 0) return null;
  return pans && event.shiftKey ? "pan" : "main";
}

/** Returns how to stop listening. */
export function listenToPointer(element: HTMLElement, handlers: PointerHandlers): () => void {
  let drag: { id: number; x: number; y: number; button: DragButton; clicks: boolean; moved: boolean } | null = null;
  /** A mouse was let go without moving: the browser's click follows, and tells which of a series it is. */
  let clickFollows = false;
  const clicks = new ClickCounter();

  const place = (event: MouseEvent): PointerPlace => {
    const box = element.getBoundingClientRect();
    return { x: event.clientX - box.left, y: event.clientY - box.top };
  };
  const down = (event: PointerEvent) => {
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
    if (drag === null) {
      handlers.hover?.(place(event), event.shiftKey);
      return;
    }
    if (event.pointerId !== drag.id) return;
    const dx = event.clientX - drag.x;
    const dy = event.clientY - drag.y;
    if (!drag.moved && Math.hypot(dx, dy) < CLICK_PX) return;
    drag = { ...drag, moved: true, x: event.clientX, y: event.clientY };
    handlers.drag?.(place(event), { dx, dy }, drag.button);
  };
  const up = (event: PointerEvent) => {
    if (drag === null || event.pointerId !== drag.id) return;
    const wasClick = !drag.moved && event.type === "pointerup";
    const held = drag;
    drag = null;
    if (!wasClick || !held.clicks) {
      clicks.forget();
      handlers.release?.();
      if (wasClick && held.button === "window") handlers.secondaryClick?.(place(event));
    } else if (event.pointerType === "mouse") clickFollows = true;
    // Browsers count the clicks of a mouse as the system is set to; those of fingers and pens not all of them count.
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
  // The browser would scroll by itself.
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
