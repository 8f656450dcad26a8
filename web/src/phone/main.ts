/** Entry point of the phone page: connects the orientation sensor and the buttons of the phone to the server. */

import "./phone.css";
import { Link } from "./link";
import { penOrientation } from "./orientation";
import { type Held, PhoneInput } from "./phone-input";
import { NO_SENSOR, SENSOR_REFUSED, SENSOR_WITHIN_MS, stateText } from "./texts";

function element<T extends HTMLElement>(id: string): T {
  const found = document.getElementById(id);
  if (found === null) throw new Error(`the page has no element ${id}`);
  return found as T;
}

function socketAddress(): string {
  const address = new URL("./phone", location.href);
  address.protocol = "wss:";
  address.hash = "";
  return address.href;
}

const state = element("state");
const sensor = element("sensor");
const say = (words: string, tone: "good" | "wait" | "bad") => {
  state.textContent = words;
  document.body.dataset.tone = tone;
};

const link = new Link(
  () => new WebSocket(socketAddress()),
  location.hash.slice(1),
  {
    status: (status, words) => {
      if (status !== "open") say(words, status === "refused" ? "bad" : "wait");
      // Release all buttons when the connection is lost, so that a button held at that time does not move the tip after
      // the reconnection.
      if (status !== "open") release();
    },
    state: (received) => say(stateText(received), "good"),
  },
  (ms, call) => {
    const timer = setTimeout(call, ms);
    return () => clearTimeout(timer);
  },
);
const hand = new PhoneInput(link.send);
const holders: [HTMLElement, Held][] = [
  [element("turn"), "turn"],
  [element("forward"), "forward"],
  [element("back"), "back"],
];

function release(): void {
  hand.release();
  for (const [button] of holders) delete button.dataset.held;
}

for (const [button, what] of holders) {
  const set = (down: boolean) => {
    hand.hold(what, down);
    if (down) button.dataset.held = "true";
    else delete button.dataset.held;
  };
  button.addEventListener("pointerdown", (event) => {
    button.setPointerCapture(event.pointerId);
    set(true);
  });
  for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) {
    button.addEventListener(name, () => set(false));
  }
  // Whether a key holds the button. It is separate from touch, because the touch of a second button takes the focus
  // from the first one.
  let byKey = false;
  const key = (down: boolean) => {
    if (down || byKey) set(down);
    byKey = down;
  };
  button.addEventListener("keydown", (event) => {
    if (event.key !== " " && event.key !== "Enter") return;
    event.preventDefault();
    key(true);
  });
  button.addEventListener("keyup", () => key(false));
  button.addEventListener("blur", () => key(false));
  // Prevent the context menu, which a long press would open.
  button.addEventListener("contextmenu", (event) => event.preventDefault());
}

element("recenter").addEventListener("click", () => link.send({ type: "phone_act", action: "recenter" }));
element("mode").addEventListener("click", () => link.send({ type: "phone_act", action: "next_control" }));

/**
 * Request permission to read the orientation sensor. iOS requires the request, and permits it only in response to a
 * tap.
 */
async function mayRead(): Promise<boolean> {
  const events = globalThis.DeviceOrientationEvent as
    | (typeof DeviceOrientationEvent & { requestPermission?: () => Promise<string> })
    | undefined;
  if (events === undefined) return true;
  if (events.requestPermission === undefined) return true;
  try {
    return (await events.requestPermission()) === "granted";
  } catch {
    return false;
  }
}

async function stayAwake(): Promise<void> {
  try {
    await navigator.wakeLock?.request("screen");
  } catch {
    // Continue without a wake lock: the screen may switch off, and a tap switches it on again.
  }
}

let seen = false;

element("use").addEventListener("click", () => {
  void (async () => {
    const allowed = await mayRead();
    element("begin").hidden = true;
    element("control").hidden = false;
    void stayAwake();
    sensor.textContent = allowed ? "" : SENSOR_REFUSED;
    if (!allowed) return;
    addEventListener("deviceorientation", (event) => {
      const turned = penOrientation(event);
      if (turned === null) return;
      if (!seen) sensor.textContent = "";
      seen = true;
      hand.turned(turned);
    });
    setTimeout(() => {
      if (!seen) sensor.textContent = NO_SENSOR;
    }, SENSOR_WITHIN_MS);
  })();
});

document.addEventListener("visibilitychange", () => {
  if (document.visibilityState === "hidden") {
    release();
    hand.tick(performance.now() / 1000);
  } else if (!element("control").hidden) void stayAwake();
});
addEventListener("pagehide", () => link.close());
addEventListener("pageshow", (event) => {
  if (event.persisted) link.open();
});

function tick(nowMs: number): void {
  hand.tick(nowMs / 1000);
  requestAnimationFrame(tick);
}
requestAnimationFrame(tick);
link.open();
