/** VR headset connected by WebXR: its controllers act as tracked pens, and its frame loop draws the airway picture. */

import type { ClientMessage } from "../../wire/messages";
import type { Action } from "../keymap";
import { shaped } from "./gamepad";

// Types of the part of WebXR that Carina uses, because TypeScript's library does not declare WebXR.

/** WebXR `DOMPointReadOnly`: a point or a quaternion. */
export interface XrPoint {
  readonly x: number;
  readonly y: number;
  readonly z: number;
  readonly w: number;
}
/** WebXR `XRRigidTransform`. */
export interface XrTransform {
  readonly position: XrPoint;
  readonly orientation: XrPoint;
  readonly matrix: Float32Array;
  readonly inverse: { readonly matrix: Float32Array };
}
/** WebXR `XRView`: one eye. */
export interface XrView {
  readonly projectionMatrix: Float32Array;
  readonly transform: XrTransform;
}
/** WebXR `XRViewerPose`. */
export interface XrViewerPose {
  readonly transform: XrTransform;
  readonly views: readonly XrView[];
}
/** WebXR `XRSpace`. */
export type XrSpace = object;
/** WebXR `XRInputSource`: a controller. */
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
/** WebXR `XRFrame`. */
export interface XrFrame {
  getPose(space: XrSpace, base: XrSpace): { readonly transform: XrTransform } | null | undefined;
  getViewerPose(base: XrSpace): XrViewerPose | null | undefined;
}
/** WebXR `XRSession`. */
export interface XrSession extends EventTarget {
  readonly inputSources: Iterable<XrInputSource>;
  readonly visibilityState?: string;
  requestReferenceSpace(kind: string): Promise<XrSpace>;
  requestAnimationFrame(call: (timeMs: number, frame: XrFrame) => void): number;
  updateRenderState(state: object): void;
  end(): Promise<void>;
}
/** WebXR `XRSystem`. */
export interface Xr extends EventTarget {
  isSessionSupported(mode: string): Promise<boolean>;
  requestSession(mode: string, options?: object): Promise<XrSession>;
}

/**
 * Virtual screen in the headset that draws the latest airway picture at each frame, without waiting for the next
 * picture.
 */
export interface HeadsetScreen {
  open(session: XrSession): Promise<void>;
  draw(viewer: XrViewerPose): void;
  /** Place the screen in front of the user again. */
  recenter(): void;
  close(): void;
}

/** Page functions that {@link Headset} uses; tests supply fakes. */
export interface HeadsetHooks {
  readonly screen: HeadsetScreen;
  send(message: ClientMessage): void;
  act(action: Action): void;
  /** Return whether an open case allows movement of the tip. */
  enabled(): boolean;
  /**
   * Return the clutch setting of pens (`controls.clutch`): true if a pen moves the tip while its clutch is held, false
   * if while it is released.
   */
  clutchHeldMoves(): boolean;
  changed(inside: boolean): void;
  failed(words: string): void;
}

/** Availability of a headset in this browser. */
export type HeadsetOffer = "no-webxr" | "no-headset" | "ready";

/** Return the availability of a headset in this browser and on this computer. */
export async function headsetOffer(xr: Xr | null): Promise<HeadsetOffer> {
  if (xr === null) return "no-webxr";
  try {
    return (await xr.isSessionSupported("immersive-vr")) ? "ready" : "no-headset";
  } catch {
    return "no-headset";
  }
}

/** Index of the trigger among the buttons, in WebXR's "xr-standard" mapping. */
const TRIGGER = 0;
/** Index of the grip button, in WebXR's "xr-standard" mapping. */
const SQUEEZE = 1;
/** Index of the lower button, in WebXR's "xr-standard" mapping. */
const LOWER = 4;
/** Index of the upper button, in WebXR's "xr-standard" mapping. */
const UPPER = 5;
/** Index of the stick's vertical axis, in WebXR's "xr-standard" mapping. */
const STICK_Y = 3;
/** Minimum value of a trigger or button, 0 to 1, that counts as held. */
const HELD = 0.5;
/** Millimetres per metre; WebXR gives lengths in metres. */
const MM_PER_M = 1000;
/** Bit of a sample's buttons that states whether the clutch is held (the tip then follows the hand). */
const CLUTCH_BIT = 2;

/**
 * Convert the orientation of a controller grip to that of a pen (quaternion w, x, y, z). WebXR's axes are right, up,
 * back; a pen's axes are right, down, forward. The conversion is a half turn about x.
 */
export function penFromGrip({ x, y, z, w }: XrPoint): readonly [number, number, number, number] {
  return [-x + 0, w + 0, z + 0, -y + 0];
}

interface Controller {
  readonly name: string;
  speaks: boolean;
  pressed: ReadonlySet<number>;
}

/** Session in a VR headset: frame loop, controllers and virtual screen. */
export class Headset {
  readonly #xr: Xr;
  readonly #hooks: HeadsetHooks;
  #session: XrSession | null = null;
  #space: XrSpace | null = null;
  #entering = false;
  readonly #controllers = new Map<XrInputSource, Controller>();
  #faultReported = false;

  constructor(xr: Xr, hooks: HeadsetHooks) {
    this.#xr = xr;
    this.#hooks = hooks;
  }

  get inside(): boolean {
    return this.#session !== null;
  }

  get names(): readonly string[] {
    return [...this.#controllers.values()].map((controller) => controller.name);
  }

  /** Start the session in the headset. Browsers permit the start only in response to a click. */
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
      session.addEventListener("inputsourceschange", () => this.#removeDisconnected(begun));
      this.#space = await session.requestReferenceSpace("local");
      await this.#hooks.screen.open(session);
      if (isOver) throw new Error("the headset was taken off meanwhile");
      session.requestAnimationFrame(this.#frame);
      this.#session = session;
      this.#faultReported = false;
      this.#hooks.changed(true);
    } catch (trouble) {
      this.#space = null;
      this.#hooks.screen.close();
      this.#hooks.failed(`The headset view could not be started: ${textsOf(trouble)}.`);
      await session?.end().catch(() => undefined);
    } finally {
      this.#entering = false;
    }
  }

  async leave(): Promise<void> {
    await this.#session?.end().catch(() => undefined);
  }

  /** Vibrate every controller that supports it. */
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
    // Request the next frame before this frame is drawn, so that an error below does not stop the frame loop.
    session.requestAnimationFrame(this.#frame);
    try {
      this.#read(session, space, timeMs / 1000, frame);
      const viewer = frame.getViewerPose(space);
      if (viewer != null) this.#hooks.screen.draw(viewer);
    } catch (trouble) {
      if (!this.#faultReported) this.#hooks.failed(`The headset image could not be drawn: ${textsOf(trouble)}.`);
      this.#faultReported = true;
    }
  };

  #read(session: XrSession, space: XrSpace, timeS: number, frame: XrFrame): void {
    // While the headset's system menu is open, the controllers do not move the tip.
    const listens = this.#hooks.enabled() && (session.visibilityState ?? "visible") === "visible";
    for (const source of session.inputSources) {
      if (source.gamepad == null) continue;
      const controller = this.#controllerOf(source);
      const { axes, buttons } = source.gamepad;
      const value = (n: number) => buttons[n]?.value ?? 0;
      const now = new Set([SQUEEZE, LOWER, UPPER].filter((n) => buttons[n]?.pressed === true));
      const fresh = (n: number) => now.has(n) && !controller.pressed.has(n);
      if (fresh(SQUEEZE)) this.#hooks.screen.recenter();
      if (listens && fresh(UPPER)) this.#hooks.act("reset_look");
      controller.pressed = now;

      const held = listens && value(TRIGGER) > HELD;
      const advance = listens ? shaped(-(axes[STICK_Y] ?? 0)) + 0 : 0;
      const speaks = held || advance !== 0 || (listens && now.has(LOWER));
      const pose = speaks || controller.speaks ? frame.getPose(source.gripSpace ?? source.targetRaySpace, space) : null;
      if (pose == null) {
        // Without tracking the controller sends no sample, so the tip stays until tracking returns.
        continue;
      }
      controller.speaks = speaks;
      const { position, orientation } = pose.transform;
      this.#hooks.send({
        type: "device_sample",
        device: controller.name,
        time_s: timeS,
        position_mm: [position.x * MM_PER_M, position.y * MM_PER_M, position.z * MM_PER_M],
        orientation_wxyz: penFromGrip(orientation),
        axes: null,
        // Set the clutch bit so that the tip moves while the trigger is held, whatever the clutch setting of pens is.
        buttons: Number(now.has(LOWER)) + (held === this.#hooks.clutchHeldMoves() ? CLUTCH_BIT : 0),
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

  #removeDisconnected(session: XrSession): void {
    const there = new Set(session.inputSources);
    for (const source of [...this.#controllers.keys()]) if (!there.has(source)) this.#forget(source);
  }

  #forget(source: XrInputSource): void {
    const controller = this.#controllers.get(source);
    this.#controllers.delete(source);
    if (controller !== undefined) this.#hooks.send({ type: "device_gone", device: controller.name });
  }

  #ended(session: XrSession): void {
    if (this.#session !== session) return;
    this.#session = null;
    this.#space = null;
    for (const source of [...this.#controllers.keys()]) this.#forget(source);
    this.#hooks.screen.close();
    this.#hooks.changed(false);
  }
}

function textsOf(trouble: unknown): string {
  // In some environments a DOMException is not an Error.
  const reason = trouble instanceof DOMException || trouble instanceof Error ? trouble.message : "";
  return reason.replace(/\.$/, "") || "the browser refused access";
}
