import { beforeEach, describe, expect, it } from "vitest";
import type { ClientMessage, DeviceSampleMessage } from "../../wire/messages";
import { checkClientMessage } from "../../wire/parse";
import type { Action } from "../keymap";
import {
  Headset,
  headsetOffer,
  penFromGrip,
  type Xr,
  type XrFrame,
  type XrInputSource,
  type XrSession,
  type XrTransform,
} from "./webxr";

const IDENTITY = new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);
const at = (x: number, y: number, z: number, turn = { x: 0, y: 0, z: 0, w: 1 }): XrTransform => ({
  position: { x, y, z, w: 1 },
  orientation: turn,
  matrix: IDENTITY,
  inverse: { matrix: IDENTITY },
});

class FakeController implements XrInputSource {
  readonly gripSpace = {};
  readonly targetRaySpace = {};
  place: XrTransform | null = at(0, 0, 0);
  pulses: number[] = [];
  shakes = true;
  readonly handedness: string;
  readonly #values = [0, 0, 0, 0, 0, 0];
  #stick = 0;
  constructor(handedness: string) {
    this.handedness = handedness;
  }
  press(n: number, value: number): void {
    this.#values[n] = value;
  }
  push(y: number): void {
    this.#stick = y;
  }
  get gamepad() {
    const pulse = (strength: number) => {
      this.pulses.push(strength);
      return this.shakes ? Promise.resolve() : Promise.reject(new Error("it shakes no more"));
    };
    return {
      axes: [0, 0, 0, this.#stick],
      buttons: this.#values.map((value) => ({ value, pressed: value > 0.5 })),
      hapticActuators: [{ pulse }],
    };
  }
}

class FakeSession extends EventTarget implements XrSession {
  inputSources: FakeController[] = [];
  visibilityState = "visible";
  calls: ((timeMs: number, frame: XrFrame) => void)[] = [];
  ended = false;
  requestReferenceSpace(): Promise<object> {
    return Promise.resolve({});
  }
  requestAnimationFrame(call: (timeMs: number, frame: XrFrame) => void): number {
    this.calls.push(call);
    return this.calls.length;
  }
  updateRenderState(): void {}
  end(): Promise<void> {
    if (!this.ended) {
      this.ended = true;
      this.dispatchEvent(new Event("end"));
    }
    return Promise.resolve();
  }
  /** Run one frame of the headset. */
  refresh(timeMs: number): void {
    const sources = this.inputSources;
    const frame: XrFrame = {
      getPose: (space) => {
        const place = sources.find((source) => source.gripSpace === space)?.place;
        return place == null ? null : { transform: place };
      },
      getViewerPose: () => ({ transform: at(0, 0, 0), views: [] }),
    };
    for (const call of this.calls.splice(0)) call(timeMs, frame);
  }
}

class FakeXr extends EventTarget implements Xr {
  session = new FakeSession();
  refuses: Error | null = null;
  supports: boolean | Error = true;
  isSessionSupported(): Promise<boolean> {
    return this.supports instanceof Error ? Promise.reject(this.supports) : Promise.resolve(this.supports);
  }
  requestSession(): Promise<XrSession> {
    return this.refuses === null ? Promise.resolve(this.session) : Promise.reject(this.refuses);
  }
}

let xr: FakeXr;
let sent: ClientMessage[];
let acts: Action[];
let failures: string[];
let changes: boolean[];
let drawn: number;
let recentred: number;
let closed: number;
let openFails: Error | null;
let whileOpening: () => void;
let drawFails: Error | null;
let clutchHeld: boolean;
let enabled: boolean;
let headset: Headset;
let right: FakeController;

beforeEach(() => {
  xr = new FakeXr();
  [sent, acts, failures, changes] = [[], [], [], []];
  drawn = recentred = closed = 0;
  whileOpening = () => undefined;
  openFails = drawFails = null;
  clutchHeld = false;
  enabled = true;
  right = new FakeController("right");
  xr.session.inputSources = [right];
  headset = new Headset(xr, {
    screen: {
      open: () => {
        whileOpening();
        return openFails === null ? Promise.resolve() : Promise.reject(openFails);
      },
      draw: () => {
        drawn += 1;
        if (drawFails !== null) throw drawFails;
      },
      recenter: () => {
        recentred += 1;
      },
      close: () => {
        closed += 1;
      },
    },
    send: (message) => {
      checkClientMessage(JSON.stringify(message));
      sent.push(message);
    },
    act: (action) => acts.push(action),
    enabled: () => enabled,
    clutchHeldMoves: () => clutchHeld,
    changed: (inside) => changes.push(inside),
    failed: (words) => failures.push(words),
  });
});

const samples = () => sent.filter((message): message is DeviceSampleMessage => message.type === "device_sample");

describe("headsetOffer", () => {
  it("returns no-webxr, no-headset or ready depending on the browser and the computer", async () => {
    expect(await headsetOffer(null)).toBe("no-webxr");
    expect(await headsetOffer(xr)).toBe("ready");
    xr.supports = false;
    expect(await headsetOffer(xr)).toBe("no-headset");
    xr.supports = new Error("not allowed here");
    expect(await headsetOffer(xr)).toBe("no-headset");
  });
});

describe("controller of a headset", () => {
  it("Its sample has a position in mm and an orientation with the axes right, down and forward.", async () => {
    await headset.enter();
    right.place = at(0.1, 1.2, -0.3);
    right.press(0, 1);
    xr.session.refresh(1000);
    expect(samples()[0]).toMatchObject({
      device: "headset right",
      time_s: 1,
      position_mm: [100, 1200, -300],
      orientation_wxyz: [0, 1, 0, 0],
      buttons: 0,
      advance: 0,
    });
  });

  it("Its orientation equals the grip's rotation matrix with the columns right, -up and -back.", () => {
    const turn = { x: 0.1, y: -0.5, z: 0.3, w: Math.sqrt(1 - 0.35) };
    const axis = (q: readonly [number, number, number, number], n: 0 | 1 | 2) => {
      const [w, x, y, z] = q;
      const columns = [
        [1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)],
        [2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)],
        [2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)],
      ] as const;
      return columns[n];
    };
    const pen = penFromGrip(turn);
    const grip = [turn.w, turn.x, turn.y, turn.z] as const;
    for (const [n, sign] of [
      [0, 1],
      [1, -1],
      [2, -1],
    ] as const) {
      for (const row of [0, 1, 2] as const) expect(axis(pen, n)[row]).toBeCloseTo(sign * axis(grip, n)[row], 12);
    }
  });

  it("No sample is sent while the trigger is released, and one sample is sent when it is released.", async () => {
    await headset.enter();
    for (let n = 0; n < 30; n += 1) xr.session.refresh(n * 11);
    expect(samples()).toEqual([]);
    right.press(0, 1);
    for (let n = 30; n < 40; n += 1) xr.session.refresh(n * 11);
    right.press(0, 0);
    for (let n = 40; n < 60; n += 1) xr.session.refresh(n * 11);
    expect(samples().length).toBe(11);
    expect(samples().at(-1)?.buttons).toBe(2);
    expect(drawn).toBe(60);
  });

  it.each([false, true])("A held trigger moves the tip whatever the clutch setting is (%s).", async (hold) => {
    clutchHeld = hold;
    await headset.enter();
    right.press(0, 1);
    xr.session.refresh(0);
    right.press(0, 0);
    right.push(-1);
    xr.session.refresh(11);
    const [held, pushed] = samples();
    expect(((held?.buttons ?? 0) & 2) !== 0).toBe(hold);
    expect(((pushed?.buttons ?? 0) & 2) !== 0).toBe(!hold);
    expect(pushed?.advance).toBe(1);
  });

  it("A held button runs its action once.", async () => {
    await headset.enter();
    for (const button of [1, 4, 5]) right.press(button, 1);
    for (let n = 0; n < 5; n += 1) xr.session.refresh(n * 11);
    expect(recentred).toBe(1);
    expect(acts).toEqual(["reset_look"]);
    expect(samples().every((sample) => (sample.buttons & 1) === 1)).toBe(true);
  });

  it("No sample is sent under the headset's system menu, without a case, or without tracking.", async () => {
    await headset.enter();
    right.press(0, 1);
    xr.session.visibilityState = "visible-blurred";
    xr.session.refresh(0);
    xr.session.visibilityState = "visible";
    enabled = false;
    xr.session.refresh(11);
    enabled = true;
    right.place = null;
    xr.session.refresh(22);
    expect(samples()).toEqual([]);
    right.place = at(0, 0, 0);
    xr.session.refresh(33);
    expect(samples().length).toBe(1);
  });

  it("The view-reset button has no effect under the system menu, without a case, or if it was held before.", async () => {
    await headset.enter();
    xr.session.visibilityState = "visible-blurred";
    right.press(5, 1);
    xr.session.refresh(0);
    right.press(5, 0);
    xr.session.refresh(11);
    xr.session.visibilityState = "visible";
    enabled = false;
    right.press(5, 1);
    xr.session.refresh(22);
    // The button was pressed before the headset was enabled, so that it does not count as a new press.
    enabled = true;
    xr.session.refresh(33);
    expect(acts).toEqual([]);
    right.press(5, 0);
    xr.session.refresh(44);
    right.press(5, 1);
    xr.session.refresh(55);
    expect(acts).toEqual(["reset_look"]);
  });

  it("A controller that is switched off is reported as gone, and its samples are sent again after its return.", async () => {
    await headset.enter();
    right.press(0, 1);
    xr.session.refresh(0);
    xr.session.inputSources = [];
    xr.session.dispatchEvent(new Event("inputsourceschange"));
    expect(sent.at(-1)).toEqual({ type: "device_gone", device: "headset right" });
    expect(headset.names).toEqual([]);
    xr.session.inputSources = [right];
    xr.session.refresh(11);
    expect(samples().length).toBe(2);
  });

  it("The controller vibrates, and a rejected vibration causes no message.", async () => {
    await headset.enter();
    xr.session.refresh(0);
    headset.rumble(0.6, 120);
    expect(right.pulses).toEqual([0.6]);
    // A controller may reject the vibration; an unhandled rejection would fail the test run.
    right.shakes = false;
    headset.rumble(0.6, 120);
    await new Promise((done) => setTimeout(done, 0));
    expect(failures).toEqual([]);
  });
});

describe("Headset", () => {
  it("reports the end of a session by the system, and can be entered again", async () => {
    await headset.enter();
    xr.session.refresh(0);
    await xr.session.end();
    expect([headset.inside, changes]).toEqual([false, [true, false]]);
    expect(sent.at(-1)).toEqual({ type: "device_gone", device: "headset right" });
    xr.session = new FakeSession();
    await headset.enter();
    expect(headset.inside).toBe(true);
    await headset.leave();
    expect(changes).toEqual([true, false, true, false]);
  });

  it("reports why it cannot be entered, and ends a session whose screen cannot be opened", async () => {
    xr.refuses = new Error("the headset is in use");
    await headset.enter();
    expect(failures).toEqual(["The headset view could not be started: the headset is in use."]);
    xr.refuses = null;
    openFails = new Error("no WebGL");
    await headset.enter();
    expect([headset.inside, xr.session.ended, changes]).toEqual([false, true, []]);
  });

  it("can be entered again after the session ended while its screen was being opened", async () => {
    whileOpening = () => void xr.session.end();
    await headset.enter();
    expect([headset.inside, closed, changes]).toEqual([false, 1, []]);
    expect(failures).toEqual(["The headset view could not be started: the headset was taken off meanwhile."]);
    whileOpening = () => undefined;
    xr.session = new FakeSession();
    xr.session.inputSources = [right];
    await headset.enter();
    xr.session.refresh(11);
    expect([headset.inside, drawn, changes]).toEqual([true, 1, [true]]);
  });

  it("can be entered again after the session refused the first frame request", async () => {
    xr.session.requestAnimationFrame = () => {
      throw new DOMException("the session has ended", "InvalidStateError");
    };
    await headset.enter();
    expect([headset.inside, closed, changes]).toEqual([false, 1, []]);
    xr.session = new FakeSession();
    await headset.enter();
    expect(headset.inside).toBe(true);
  });

  it("The frame loop continues when drawing fails, and the error is reported once per session.", async () => {
    await headset.enter();
    drawFails = new Error("the graphics context was lost");
    for (let n = 0; n < 20; n += 1) xr.session.refresh(n * 11);
    expect(drawn).toBe(20);
    expect(failures.length).toBe(1);
    await headset.leave();
    xr.session = new FakeSession();
    await headset.enter();
    xr.session.refresh(0);
    expect(failures.length).toBe(2);
  });

  it("Two simultaneous requests to enter start one session.", async () => {
    await Promise.all([headset.enter(), headset.enter()]);
    expect(changes).toEqual([true]);
  });
});
