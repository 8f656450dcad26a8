import { describe, expect, it } from "vitest";
import type { ClientMessage } from "../../wire/messages";
import type { Action } from "../keymap";
import { Gamepads, type Pad, padAxes, shaped } from "./gamepad";

function pad(axes: number[] = [0, 0, 0, 0], pressed: number[] = [], change: Partial<Pad> = {}): Pad {
  const buttons = Array.from({ length: 17 }, (_, n) => ({
    pressed: pressed.includes(n),
    value: pressed.includes(n) ? 1 : 0,
  }));
  return { index: 0, id: "Test pad", connected: true, mapping: "standard", axes, buttons, ...change };
}

function pads() {
  const sent: ClientMessage[] = [];
  const acted: Action[] = [];
  const there: { now: (Pad | null)[] } = { now: [] };
  let seconds = 0;
  const made = new Gamepads({
    pads: () => there.now,
    nowS: () => {
      seconds += 0.016;
      return seconds;
    },
    send: (message) => sent.push(message),
    act: (action) => acted.push(action),
    enabled: () => true,
  });
  const tick = (...now: (Pad | null)[]) => {
    there.now = now;
    made.tick();
  };
  return { made, sent, acted, tick };
}

describe("Gamepads", () => {
  it("Sticks and triggers are converted to six axes, and values within the dead zone to 0.", () => {
    expect(padAxes(pad([0.1, -0.1, 0.05, 0]))).toEqual([0, 0, 0, 0, 0, 0]);
    expect(padAxes(pad([0, -1, 0, 0]))).toEqual([1, 0, 0, 0, 0, 0]);
    expect(padAxes(pad([1, 0, -1, -1]))).toEqual([0, 0, 0, -1, 1, 1]);
    expect(padAxes(pad([0, 0, 0, 0], [6]))[0]).toBe(-1);
    expect(padAxes(pad([0, -1, 0, 0], [7]))[0]).toBe(1);
    expect(shaped(Number.NaN)).toBe(0);
    expect(shaped(0.56)).toBeCloseTo(0.25, 9);
    expect(padAxes(pad([]))).toEqual([0, 0, 0, 0, 0, 0]);
  });

  it("A sample is sent at each refresh while a stick is deflected, once when it returns to rest, and then none.", () => {
    const { sent, tick } = pads();
    tick(pad());
    expect(sent).toEqual([]);
    tick(pad([0, -1, 0, 0]));
    tick(pad([0, -1, 0, 0]));
    tick(pad());
    tick(pad());
    expect(sent.map((m) => (m.type === "device_sample" ? m.axes?.[0] : null))).toEqual([1, 1, 0]);
    const times = sent.map((m) => (m.type === "device_sample" ? m.time_s : 0));
    expect(times).toEqual([...times].sort((a, b) => a - b));
  });

  it("A button runs its key action once per press, but not if it was pressed when the gamepad was first seen.", () => {
    const { acted, tick } = pads();
    tick(pad([], [3]));
    tick(pad([], [3]));
    expect(acted).toEqual([]);
    tick(pad());
    tick(pad([], [3, 0]));
    tick(pad([], [3, 0]));
    expect(acted).toEqual(["auto_advance", "toggle_mode"].sort());
    const other = pads();
    other.tick(pad([], [], { mapping: "" }));
    other.tick(pad([], [3], { mapping: "" }));
    expect(other.acted).toEqual([]);
  });

  it("A disconnected gamepad is reported as gone, and its samples are sent again after it reconnects.", () => {
    const { made, sent, tick } = pads();
    tick(pad([0, -1, 0, 0]));
    expect(made.names).toEqual(["gamepad 1: Test pad"]);
    tick(null);
    expect(sent.at(-1)).toEqual({ type: "device_gone", device: "gamepad 1: Test pad" });
    tick(pad([0, -1, 0, 0]));
    expect(sent.at(-1)?.type).toBe("device_sample");
  });

  it("Gamepads with a vibration actuator vibrate, and those without one cause no error.", () => {
    const { made, tick } = pads();
    const effects: object[] = [];
    const shaking = pad([], [], {
      vibrationActuator: {
        playEffect: (_kind, effect) => {
          effects.push(effect);
          return Promise.reject(new Error("no"));
        },
      },
    });
    tick(shaking, pad([], [], { index: 1, vibrationActuator: null }), null);
    made.rumble(0.5, 80);
    expect(effects).toEqual([{ duration: 80, strongMagnitude: 0.5, weakMagnitude: 0.5 }]);
  });
});
