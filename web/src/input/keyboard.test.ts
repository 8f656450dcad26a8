// @vitest-environment jsdom
import { afterEach, describe, expect, it } from "vitest";
import { focusKind, listenToKeys } from "./keyboard";

function listening(
  options: { path?: boolean; enabled?: boolean; brush?: boolean; tool?: boolean; task?: boolean } = {},
) {
  const calls: string[] = [];
  const stop = listenToKeys(window, {
    press: (action) => calls.push(action),
    hold: (axis, sign, down) => calls.push(`${axis} ${sign} ${down ? "down" : "up"}`),
    slow: () => undefined,
    isAvailable: (action) => options.brush ?? !action.startsWith("brush_"),
    inTask: () => options.task ?? false,
    holdsTool: () => options.tool ?? false,
    arrowsLook: () => !(options.path ?? true),
    enabled: () => options.enabled ?? true,
  });
  return { calls, stop };
}

function type(key: string, target: EventTarget = document.body, kind = "keydown", init: KeyboardEventInit = {}) {
  const event = new KeyboardEvent(kind, { key, code: `code ${key}`, bubbles: true, cancelable: true, ...init });
  target.dispatchEvent(event);
  return event;
}

let stop: () => void = () => undefined;
afterEach(() => {
  stop();
  document.body.replaceChildren();
});

describe("listenToKeys", () => {
  it("A movement key on the page starts and ends a movement, and the browser does not receive the key.", () => {
    const keys = listening();
    stop = keys.stop;
    expect(type("w").defaultPrevented).toBe(true);
    type("w", document.body, "keydown", { repeat: true });
    type("w", document.body, "keyup");
    expect(keys.calls).toEqual(["advance 1 down", "advance 1 up"]);
  });

  it("The browser receives keys in a text field, keys without a binding, and keys with Ctrl.", () => {
    const keys = listening();
    stop = keys.stop;
    const input = document.createElement("input");
    document.body.append(input);
    expect(type("w", input).defaultPrevented).toBe(false);
    expect(type("Tab").defaultPrevented).toBe(false);
    expect(type("r", document.body, "keydown", { ctrlKey: true }).defaultPrevented).toBe(false);
    expect(keys.calls).toEqual([]);
  });

  it("Left and right arrow on the button of a closed list do not reach the list, which would change its value.", () => {
    const keys = listening();
    stop = keys.stop;
    const button = document.createElement("button");
    button.setAttribute("aria-haspopup", "listbox");
    document.body.append(button);
    const received: string[] = [];
    button.addEventListener("keydown", ({ key }) => received.push(key));
    for (const key of ["ArrowLeft", "ArrowRight", "ArrowDown", "Enter"]) type(key, button);
    expect(received).toEqual(["ArrowDown", "Enter"]);
    expect(keys.calls).toEqual([]);
  });

  it("A focused slider receives the arrow keys, and a focused button the space bar.", () => {
    const keys = listening();
    stop = keys.stop;
    const slider = document.createElement("input");
    slider.type = "range";
    const button = document.createElement("button");
    document.body.append(slider, button);
    expect(type("ArrowUp", slider).defaultPrevented).toBe(false);
    expect(type(" ", button).defaultPrevented).toBe(false);
    type("m", button);
    expect(keys.calls).toEqual(["toggle_mode"]);
  });

  it("The left arrow selects a branch on a route, and turns the view without a route.", () => {
    const onPath = listening({ path: true });
    type("ArrowLeft");
    onPath.stop();
    expect(onPath.calls).toEqual(["way_left"]);
    const free = listening({ path: false });
    stop = free.stop;
    type("ArrowLeft");
    type("ArrowLeft", document.body, "keyup");
    expect(free.calls).toEqual(["yaw -1 down", "yaw -1 up"]);
  });

  it("A held key is released when the window loses the focus.", () => {
    const keys = listening();
    stop = keys.stop;
    type("w");
    window.dispatchEvent(new Event("blur"));
    expect(keys.calls).toEqual(["advance 1 down", "advance 1 up"]);
  });

  it("Without an open case no key has an effect.", () => {
    const keys = listening({ enabled: false });
    stop = keys.stop;
    expect(type("w").defaultPrevented).toBe(false);
    expect(keys.calls).toEqual([]);
  });

  it("Z pauses a task, and has no effect without one.", () => {
    const without = listening();
    type("z");
    without.stop();
    const within = listening({ task: true });
    type("z");
    within.stop();
    expect([without.calls, within.calls]).toEqual([[], ["pause_task"]]);
  });

  it("The keys of the brush have an effect only while a brush is active.", () => {
    const without = listening();
    expect(type("]").defaultPrevented).toBe(false);
    without.stop();
    const keys = listening({ brush: true });
    stop = keys.stop;
    expect(type("]").defaultPrevented).toBe(true);
    expect([without.calls, keys.calls]).toEqual([[], ["brush_larger"]]);
  });

  it("Escape deactivates the tool, also from a list or a text field, but first closes an open dialog.", () => {
    const list = document.createElement("div");
    list.setAttribute("role", "treegrid");
    const row = document.createElement("button");
    const input = document.createElement("input");
    const dialog = document.createElement("div");
    dialog.setAttribute("role", "dialog");
    const inside = document.createElement("button");
    dialog.append(inside);
    list.append(row);
    document.body.append(list, input, dialog);
    const without = listening();
    type("Escape", row);
    type("Escape", input);
    without.stop();
    const keys = listening({ tool: true });
    stop = keys.stop;
    type("Escape", inside);
    expect(keys.calls).toEqual([]);
    type("Escape", input);
    type("Escape", row);
    expect([without.calls, keys.calls]).toEqual([[], ["leave", "leave"]]);
  });

  it("focusKind returns typing for a dialog and a text field, and page for the body.", () => {
    const dialog = document.createElement("div");
    dialog.setAttribute("role", "dialog");
    const inside = document.createElement("button");
    dialog.append(inside);
    document.body.append(dialog);
    expect(focusKind(inside)).toBe("typing");
    expect(focusKind(document.body)).toBe("page");
    expect(focusKind(document.createElement("textarea"))).toBe("typing");
  });
});
