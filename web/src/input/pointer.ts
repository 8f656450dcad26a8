/** Drags, wheel turns and double clicks on a picture, told apart once for all pictures. */

export interface PointerPlace {
  /** CSS pixels from the picture's top-left corner. */
  x: number;
  y: number;
}

export type DragButton = "main" | "window";

export interface PointerHandlers {
  /** A press that was let go without moving. */
  click?(at: PointerPlace): void;
  drag?(at: PointerPlace, moved: { dx: number; dy: number }, button: DragButton): void;
  /** A drag has ended. */
  release?(): void;
  /** The pointer passes; `shift` moves the crosshair along. */
  hover?(at: PointerPlace | null, shift: boolean): void;
  wheel?(deltaPx: number, zoom: boolean, at: PointerPlace): void;
  doubleClick?(): void;
}

/** A hand that clicks shakes by this much. */
const CLICK_PX = 3;
const LINE_PX = 16;

/** Returns how to stop listening. */
export function listenToPointer(element: HTMLElement, handlers: PointerHandlers): () => void {
  let drag: { id: number; x: number; y: number; button: DragButton; moved: boolean } | null = null;

  const place = (event: MouseEvent): PointerPlace => {
    const box = element.getBoundingClientRect();
    return { x: event.clientX - box.left, y: event.clientY - box.top };
  };
  const down = (event: PointerEvent) => {
    if (drag !== null || (event.button !== 0 && event.button !== 2)) return;
    drag = {
      id: event.pointerId,
      x: event.clientX,
      y: event.clientY,
      button: event.button === 2 ? "window" : "main",
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
    const wasClick = !drag.moved && drag.button === "main" && event.type === "pointerup";
    drag = null;
    if (wasClick) handlers.click?.(place(event));
    else handlers.release?.();
  };
  const leave = () => handlers.hover?.(null, false);
  const wheel = (event: WheelEvent) => {
    if (handlers.wheel === undefined) return;
    event.preventDefault();
    const unit = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? LINE_PX : 1;
    handlers.wheel(event.deltaY * unit, event.ctrlKey || event.metaKey, place(event));
  };
  const double = (event: MouseEvent) => {
    event.preventDefault();
    handlers.doubleClick?.();
  };
  const menu = (event: Event) => event.preventDefault();

  element.addEventListener("pointerdown", down);
  element.addEventListener("pointermove", move);
  element.addEventListener("pointerup", up);
  element.addEventListener("pointercancel", up);
  element.addEventListener("pointerleave", leave);
  element.addEventListener("wheel", wheel, { passive: false });
  element.addEventListener("dblclick", double);
  element.addEventListener("contextmenu", menu);
  return () => {
    element.removeEventListener("pointerdown", down);
    element.removeEventListener("pointermove", move);
    element.removeEventListener("pointerup", up);
    element.removeEventListener("pointercancel", up);
    element.removeEventListener("pointerleave", leave);
    element.removeEventListener("wheel", wheel);
    element.removeEventListener("dblclick", double);
    element.removeEventListener("contextmenu", menu);
  };
}
