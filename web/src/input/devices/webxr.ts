/** A headset by WebXR: its controllers as tracked pens, and a frame loop of its own for what is shown in it. */

import type { ClientMessage } from "../../wire/messages";
import type { Action } from "../keymap";
import { shaped } from "./gamepad";

// What of the browser's WebXR is used; TypeScript's own library does not know it.

export interface XrPoint {
  readonly x: number;
  readonly y: number;
  readonly z: number;
  readonly w: number;
}
export interface XrTransform {
  readonly position: XrPoint;
  readonly orientation: XrPoint;
  readonly matrix: Float32Array;
  readonly inverse: { readonly matrix: Float32Array };
}
export interface XrView {
  readonly projectionMatrix: Float32Array;
  readonly transform: XrTransform;
}
export interface XrViewerPose {
  readonly transform: XrTransform;
  readonly views: readonly XrView[];
}
export type XrSpace = object;
export interface XrInputSource {
  readonly handedness: string;
  readonly gripSpace?: XrSpace | null;
  readonly targetRaySpace: XrSpace;
  readonly gamepad?: {
    readonly axes: readonly number[];
    readonly buttons: readonly { readonly pressed: boolean; readonly value: number }[];
    readonly hapticActuators?: readonly { pulse?(strength: number, ms: number): Promise<unknown> }[] | null;
  } | null;
}
export interface XrFrame {
  getPose(space: XrSpace, base: XrSpace): { readonly transform: XrTransform } | null | undefined;
  getViewerPose(base: XrSpace): XrViewerPose | null | undefined;
}
export interface XrSession extends EventTarget {
  readonly inputSources: Iterable<XrInputSource>;
  readonly visibilityState?: string;
  requestReferenceSpace(kind: string): Promise<XrSpace>;
  requestAnimationFrame(call: (timeMs: number, frame: XrFrame) => void): number;
  updateRenderState(state: object): void;
  end(): Promise<void>;
}
export interface Xr extends EventTarget {
  isSessionSupported(mode: string): Promise<boolean>;
  requestSession(mode: string, options?: object): Promise<XrSession>;
}

/** What is shown in the headset; it draws whatever it has, and waits for nothing. */
export interface HeadsetScreen {
  open(session: XrSession): Promise<void>;
  draw(viewer: XrViewerPose): void;
  /** The picture goes in front of the person again. */
  recenter(): void;
  close(): void;
}

export interface HeadsetSurroundings {
  readonly screen: HeadsetScreen;
  send(message: ClientMessage): void;
  act(action: Action): void;
  /** Whether a case is open that may be flown in. */
  enabled(): boolean;
  /** Pens that move the tip while their clutch is held, or while it is not (`controls.clutch`). */
  clutchHeldMoves(): boolean;
  changed(inside: boolean): void;
  failed(words: string): void;
}

export type HeadsetOffer = "no-webxr" | "no-headset" | "ready";

/** What this browser and machine have. */
export async function headsetOffer(xr: Xr | null): Promise<HeadsetOffer> {
  if (xr === null) return "no-webxr";
  try {
    return (await xr.isSessionSupported("immersive-vr")) ? "ready" : "no-headset";
  } catch {
    return "no-headset";
  }
}

/** Places in the gamepad of a controller, by the "xr-standard" mapping. */
const TRIGGER = 0;
const SQUEEZE = 1;
const LOWER = 4;
const UPPER = 5;
const STICK_Y = 3;
const HELD = 0.5;
const MM_PER_M = 1000;
const CLUTCH_BIT = 2;

/**
 * A grip's turn as a pen's: WebXR's axes are right, up, back, a pen's right, down, forward. Half a turn about x; wxyz.
 */
export function penFromGrip({ x, y, z, w }: XrPoint): readonly [number, number, number, number] {
  return [-x + 0, w + 0, z + 0, -y + 0];
}

interface Controller {
  readonly name: string;
  speaks: boolean;
  pressed: ReadonlySet<number>;
}

export class Headset {
  readonly #xr: Xr;
  readonly #around: HeadsetSurroundings;
  #session: XrSession | null = null;
  #space: XrSpace | null = null;
  #entering = false;
  readonly #controllers = new Map<XrInputSource, Controller>();
  #faultSaid = false;

  constructor(xr: Xr, around: HeadsetSurroundings) {
    this.#xr = xr;
    this.#around = around;
  }

  get inside(): boolean {
    return this.#session !== null;
  }

  get names(): readonly string[] {
    return [...this.#controllers.values()].map((controller) => controller.name);
  }

  /** Needs a click: browsers let no page into a headset by itself. */
  async enter(): Promise<void> {
    if (this.#session !== null || this.#entering) return;
    this.#entering = true;
    let session: XrSession | null = null;
    let isOver = false;
    try {
      session = await this.#xr.requestSession("immersive-vr");
      const begun = session;
      session.addEventListener("end", () => {
        isOver = true;
        this.#ended(begun);
      });
      session.addEventListener("inputsourceschange", () => this.#forgetThoseGone(begun));
      this.#space = await session.requestReferenceSpace("local");
      await this.#around.screen.open(session);
      if (isOver) throw new Error("the headset was taken off meanwhile");
      session.requestAnimationFrame(this.#frame);
      this.#session = session;
      this.#faultSaid = false;
      this.#around.changed(true);
    } catch (trouble) {
      this.#space = null;
      this.#around.screen.close();
      this.#around.failed(`The headset view could not be started: ${wordsOf(trouble)}.`);
      await session?.end().catch(() => undefined);
    } finally {
      this.#entering = false;
    }
  }

  async leave(): Promise<void> {
    await this.#session?.end().catch(() => undefined);
  }

  /** Shakes every controller that can. */
  rumble(strength: number, ms: number): void {
    for (const source of this.#controllers.keys()) {
      for (const actuator of source.gamepad?.hapticActuators ?? []) {
        actuator.pulse?.(strength, ms)?.catch(() => undefined);
      }
    }
  }

  readonly #frame = (timeMs: number, frame: XrFrame): void => {
    const session = this.#session;
    const space = this.#space;
    if (session === null || space === null) return;
    // First: whatever fails below, the next picture comes.
    session.requestAnimationFrame(this.#frame);
    try {
      this.#read(session, space, timeMs / 1000, frame);
      const viewer = frame.getViewerPose(space);
      if (viewer != null) this.#around.screen.draw(viewer);
    } catch (trouble) {
      if (!this.#faultSaid) this.#around.failed(`The headset image could not be drawn: ${wordsOf(trouble)}.`);
      this.#faultSaid = true;
    }
  };

  #read(session: XrSession, space: XrSpace, timeS: number, frame: XrFrame): void {
    // While the headset's own menu is open, its controllers are not ours.
    const listens = this.#around.enabled() && (session.visibilityState ?? "visible") === "visible";
    for (const source of session.inputSources) {
      if (source.gamepad == null) continue;
      const controller = this.#controllerOf(source);
      const { axes, buttons } = source.gamepad;
      const value = (n: number) => buttons[n]?.value ?? 0;
      const now = new Set([SQUEEZE, LOWER, UPPER].filter((n) => buttons[n]?.pressed === true));
      const fresh = (n: number) => now.has(n) && !controller.pressed.has(n);
      if (fresh(SQUEEZE)) this.#around.screen.recenter();
      if (listens && fresh(UPPER)) this.#around.act("reset_look");
      controller.pressed = now;

      const held = listens && value(TRIGGER) > HELD;
      const advance = listens ? shaped(-(axes[STICK_Y] ?? 0)) + 0 : 0;
      const speaks = held || advance !== 0 || (listens && now.has(LOWER));
      const pose = speaks || controller.speaks ? frame.getPose(source.gripSpace ?? source.targetRaySpace, space) : null;
      if (pose == null) {
        // Out of the cameras' sight: the tip stays, and the hand takes it up again where it is seen.
        continue;
      }
      controller.speaks = speaks;
      const { position, orientation } = pose.transform;
      this.#around.send({
        type: "device_sample",
        device: controller.name,
        time_s: timeS,
        position_mm: [position.x * MM_PER_M, position.y * MM_PER_M, position.z * MM_PER_M],
        orientation_wxyz: penFromGrip(orientation),
        axes: null,
        // The tip moves while the trigger is held, whatever is set for the clutch of pens.
        buttons: Number(now.has(LOWER)) + (held === this.#around.clutchHeldMoves() ? CLUTCH_BIT : 0),
        handle: null,
        advance,
      });
    }
  }

  #controllerOf(source: XrInputSource): Controller {
    const known = this.#controllers.get(source);
    if (known !== undefined) return known;
    const made = { name: `headset ${source.handedness || "controller"}`, speaks: false, pressed: new Set<number>() };
    this.#controllers.set(source, made);
    return made;
  }

  #forgetThoseGone(session: XrSession): void {
    const there = new Set(session.inputSources);
    for (const source of [...this.#controllers.keys()]) if (!there.has(source)) this.#forget(source);
  }

  #forget(source: XrInputSource): void {
    const controller = this.#controllers.get(source);
    this.#controllers.delete(source);
    if (controller !== undefined) this.#around.send({ type: "device_gone", device: controller.name });
  }

  #ended(session: XrSession): void {
    if (this.#session !== session) return;
    this.#session = null;
    this.#space = null;
    for (const source of [...this.#controllers.keys()]) this.#forget(source);
    this.#around.screen.close();
    this.#around.changed(false);
  }
}

function wordsOf(trouble: unknown): string {
  // A DOMException is no Error everywhere.
  const said = trouble instanceof DOMException || trouble instanceof Error ? trouble.message : "";
  return said.replace(/\.$/, "") || "the browser refused access";
}
