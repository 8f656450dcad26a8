/**
 * Input devices of the browser: detects the devices, reads them once per display refresh, and sends their values to the
 * server.
 */

import { ContactSense } from "../input/devices/contact";
import { Gamepads, type Pad } from "../input/devices/gamepad";
import { HANDLE_FILTERS, Handle } from "../input/devices/handle";
import { type Hid, HidPort } from "../input/devices/hid-port";
import { hasPointerLock, PointerLock } from "../input/devices/pointer-lock";
import { SPACEMOUSE_FILTERS, SpaceMouse } from "../input/devices/spacemouse";
import { Headset, headsetOffer, type Xr } from "../input/devices/webxr";
import { WHEEL_MM_PER_PX } from "../input/steering";
import { isSamePen, penMessage } from "../state/path-search";
import type { Vec3 } from "../state/vec";
import { type LatestPicture, PictureScreen, type XrLayer } from "../views/headset-screen";
import type { ArmPenMessage, ClientMessage } from "../wire/messages";
import { LEAD_VIEW } from "../wire/views";
import type { Pointing } from "./pointing";
import type { Station } from "./station";

const BUMP = { strength: 0.6, ms: 120 } as const;

/** A pair of corresponding points for the calibration of a tracked pen: one in tracker space, one in patient space. */
export interface CalibrationPair {
  readonly tracker: Vec3;
  readonly patient: Vec3;
}

/** All input devices of the browser, and their connection to the workstation. */
export class BrowserDevices {
  readonly #station: Station;
  readonly #pointing: Pointing;
  readonly #pads: Gamepads;
  readonly #lock: PointerLock;
  readonly #headset: Headset | null;
  /** Port of the SpaceMouse; null if the browser has no WebHID. */
  readonly #mouse: HidPort | null;
  readonly #handle: HidPort | null;
  readonly #contact = new ContactSense();
  #armed: ArmPenMessage = { type: "arm_pen", tool: null };

  constructor(station: Station, pointing: Pointing) {
    this.#station = station;
    this.#pointing = pointing;
    const nowS = () => performance.now() / 1000;
    this.#pads = new Gamepads({
      pads: () => ("getGamepads" in navigator ? (navigator.getGamepads() as readonly (Pad | null)[]) : []),
      nowS,
      send: (message) => void station.send(message),
      act: (action) => station.act(action),
      enabled: () => this.#mayFly(),
    });
    this.#headset = this.#headsetOf(xrOf(navigator));
    const send = (message: ClientMessage) => void station.send(message);
    const hooks = {
      disconnected: (device: string) => send({ type: "device_gone", device }),
      failed: (words: string) => station.notice(words),
    };
    const hid = hidOf(navigator);
    this.#mouse =
      hid === null ? null : new HidPort(hid, SPACEMOUSE_FILTERS, (device) => new SpaceMouse(device, send, nowS), hooks);
    this.#handle =
      hid === null
        ? null
        : new HidPort(
            hid,
            HANDLE_FILTERS,
            (device) =>
              new Handle(device, send, nowS, () =>
                station.notice(
                  `${device.productName} sends reports that do not match its HID descriptor; they are ignored.`,
                ),
              ),
            hooks,
          );
    this.#lock = new PointerLock(document, {
      look: (yaw_rad, pitch_rad) => station.flight.nudge({ yaw_rad, pitch_rad }),
      wheel: (px) => station.flight.nudge({ advance_mm: -px * WHEEL_MM_PER_PX }),
      changed: (mouseLocked) => station.ui({ mouseLocked }),
      refused: (why) => station.notice(`The mouse could not be locked: ${why}.`),
    });
  }

  /** Update the availability of the headset now and whenever a headset is connected or disconnected. */
  watchHeadset(): void {
    const xr = xrOf(navigator);
    const look = () => {
      if (this.#headset?.inside === true) return;
      void headsetOffer(xr).then((headset) => this.#station.ui({ headset }));
    };
    look();
    xr?.addEventListener("devicechange", look);
  }

  /** Enter the headset view. Browsers permit the entry only in response to a click. */
  async enterHeadset(): Promise<void> {
    // Subscribe to the device messages, because they contain the clutch setting of pens, which the headset needs.
    this.#station.send({ type: "watch_devices", on: true });
    await this.#headset?.enter();
  }

  leaveHeadset(): void {
    void this.#headset?.leave();
  }

  #headsetOf(xr: Xr | null): Headset | null {
    if (xr === null) return null;
    const station = this.#station;
    const screen = new PictureScreen({
      latest: () => this.#latestPicture(),
      canvas: () => document.createElement("canvas"),
      layer: (session, gl) => {
        const { XRWebGLLayer } = globalThis as unknown as { XRWebGLLayer: new (...of: unknown[]) => XrLayer };
        return new XRWebGLLayer(session, gl);
      },
    });
    return new Headset(xr, {
      screen,
      send: (message) => void station.send(message),
      act: (action) => station.act(action),
      enabled: () => this.#mayFly(),
      clutchHeldMoves: () => station.state.devices?.controls.clutch === "hold",
      changed: (inside) => {
        station.ui({ headset: inside ? "inside" : "ready" });
        station.send({ type: "watch_devices", on: inside || station.state.ui.devicesOpen });
      },
      failed: (words) => station.notice(words),
    });
  }

  /**
   * Return the picture that the page shows in the airway view's place, for the headset's screen; null if there is none.
   */
  #latestPicture(): LatestPicture | null {
    const viewport = this.#station.wall.find(LEAD_VIEW);
    if (viewport?.header == null) return null;
    const round = this.#station.state.look.outline === "round" && viewport.header.view === LEAD_VIEW;
    return { image: viewport.picture, frameId: viewport.header.frame_id, round };
  }

  #mayFly(): boolean {
    return this.#station.state.session?.case != null && this.#station.state.start?.notice_accepted !== false;
  }

  /** Return the names of the device interfaces that this browser lacks, as text for the user. */
  missing(): readonly string[] {
    const words: string[] = [];
    if (!("getGamepads" in navigator)) words.push("gamepads");
    if (!this.hasHid) words.push("SpaceMouse and USB scope handle (they need WebHID: Chrome, Edge or Chromium)");
    if (xrOf(navigator) === null)
      words.push("headsets (they need WebXR: Chrome, Edge, Chromium or the headset's own browser)");
    if (!hasPointerLock(document)) words.push("capturing the mouse pointer");
    if (!("vibrationActuator" in globalThis || "GamepadHapticActuator" in globalThis)) words.push("rumble");
    return words;
  }

  get hasHid(): boolean {
    return this.#mouse !== null;
  }

  /** Whether the page must read a device at every display refresh. */
  get mustBeRead(): boolean {
    const ports = [this.#mouse, this.#handle].some((port) => port !== null && port.name !== null);
    return ports || this.#pads.names.length > 0 || this.#headset?.inside === true || this.#armed.tool !== null;
  }

  tick(): void {
    this.#pads.tick();
    this.#mouse?.tick();
    this.#handle?.tick();
    if (this.#contact.met(this.#station.state.pose)) {
      this.#pads.rumble(BUMP.strength, BUMP.ms);
      this.#headset?.rumble(BUMP.strength, BUMP.ms);
    }
    this.#armPen();
  }

  lockMouse(): void {
    const canvas = document.querySelector<HTMLElement>("canvas[data-view=airway]");
    if (canvas !== null) void this.#lock.request(canvas);
  }

  /** Show the browser's selection of SpaceMouse devices. Browsers permit the selection only in response to a click. */
  selectSpaceMouse(): void {
    void this.#mouse?.selectDevice();
  }

  selectHandle(): void {
    void this.#handle?.selectDevice();
  }

  stop(): void {
    this.#lock.stop();
    this.leaveHeadset();
    void this.#mouse?.stop();
    void this.#handle?.stop();
  }

  /**
   * Report to the server whether the pen's button marks a point (root, start or target tool). While it does, request
   * the path to the marked point (paper 6.3).
   */
  #armPen(): void {
    const { ui, session } = this.#station.state;
    const now = penMessage(ui, session);
    if (isSamePen(now, this.#armed)) {
      if (now.tool !== null) this.#pointing.penAt();
      return;
    }
    this.#armed = now;
    if (session?.case != null) this.#station.send(now);
  }
}

function hidOf(of: Navigator): Hid | null {
  return (of as Navigator & { hid?: Hid }).hid ?? null;
}

function xrOf(of: Navigator): Xr | null {
  return (of as Navigator & { xr?: Xr }).xr ?? null;
}
