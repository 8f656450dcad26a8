/**
 * Pointer Lock: while the mouse pointer is locked, mouse movement turns the tip and does not end at the screen's edge.
 * Escape releases the pointer.
 */

/** Rotation of the tip per pixel of mouse movement, rad. */
export const LOCK_RAD_PER_PX = 0.0025;

/** Callbacks of a {@link PointerLock}. */
export interface LockHandlers {
  look(yawRad: number, pitchRad: number): void;
  /** Handle a turn of the mouse wheel while the pointer is locked, in px of scrolling. */
  wheel(deltaPx: number): void;
  changed(locked: boolean): void;
  refused(why: string): void;
}

/** Return whether this browser supports Pointer Lock. */
export function hasPointerLock(page: Document): boolean {
  return "pointerLockElement" in page;
}

/** Lock of the mouse pointer to an element of the page. */
export class PointerLock {
  readonly #page: Document;
  readonly #handlers: LockHandlers;
  #element: HTMLElement | null = null;

  constructor(page: Document, handlers: LockHandlers) {
    this.#page = page;
    this.#handlers = handlers;
    page.addEventListener("pointerlockchange", this.#change);
  }

  get locked(): boolean {
    return this.#element !== null && this.#page.pointerLockElement === this.#element;
  }

  async request(element: HTMLElement): Promise<void> {
    this.#element = element;
    try {
      try {
        // Request movement without the pointer acceleration of the operating system; some systems do not support this
        // option.
        await element.requestPointerLock({ unadjustedMovement: true });
      } catch (trouble) {
        if (!(trouble instanceof DOMException) || trouble.name !== "NotSupportedError") throw trouble;
        await element.requestPointerLock();
      }
    } catch (trouble) {
      this.#element = null;
      // In some environments a DOMException is not an Error.
      this.#handlers.refused(trouble instanceof DOMException || trouble instanceof Error ? trouble.message : "refused");
    }
  }

  release(): void {
    if (this.locked) this.#page.exitPointerLock();
  }

  stop(): void {
    this.release();
    this.#page.removeEventListener("pointerlockchange", this.#change);
    this.#listen(false);
  }

  readonly #change = (): void => {
    const { locked } = this;
    this.#listen(locked);
    if (!locked) this.#element = null;
    this.#handlers.changed(locked);
  };

  #listen(on: boolean): void {
    const how = on ? "addEventListener" : "removeEventListener";
    this.#page[how]("mousemove", this.#move as EventListener);
    this.#page[how]("wheel", this.#wheel as EventListener);
  }

  readonly #move = (event: MouseEvent): void => {
    this.#handlers.look(event.movementX * LOCK_RAD_PER_PX, -event.movementY * LOCK_RAD_PER_PX);
  };

  readonly #wheel = (event: WheelEvent): void => this.#handlers.wheel(event.deltaY);
}
