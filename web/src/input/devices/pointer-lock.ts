/** Pointer Lock: the mouse turns the tip without an edge of the screen to stop at. Escape gives the cursor back. */

export const LOCK_RAD_PER_PX = 0.0025;

export interface LockHandlers {
  look(yawRad: number, pitchRad: number): void;
  /** The wheel, in px of scrolling. */
  wheel(deltaPx: number): void;
  changed(locked: boolean): void;
  refused(why: string): void;
}

/** Whether this browser has it. */
export function hasPointerLock(page: Document): boolean {
  return "pointerLockElement" in page;
}

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
        // Without the system's acceleration, where the system can.
        await element.requestPointerLock({ unadjustedMovement: true });
      } catch (trouble) {
        if (!(trouble instanceof DOMException) || trouble.name !== "NotSupportedError") throw trouble;
        await element.requestPointerLock();
      }
    } catch (trouble) {
      this.#element = null;
      // A DOMException is no Error everywhere.
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
