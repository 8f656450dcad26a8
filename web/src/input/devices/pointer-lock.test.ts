// @vitest-environment jsdom
import { describe, expect, it } from "vitest";
import { LOCK_RAD_PER_PX, PointerLock } from "./pointer-lock";

function page(refusals: string[]) {
  const element = document.createElement("canvas");
  let holder: Element | null = null;
  Object.defineProperty(document, "pointerLockElement", { configurable: true, get: () => holder });
  const requests: unknown[] = [];
  element.requestPointerLock = (options?: object) => {
    requests.push(options);
    const refusal = refusals.shift();
    if (refusal !== undefined) return Promise.reject(new DOMException("no", refusal));
    holder = element;
    document.dispatchEvent(new Event("pointerlockchange"));
    return Promise.resolve();
  };
  document.exitPointerLock = () => {
    holder = null;
    document.dispatchEvent(new Event("pointerlockchange"));
  };
  const looked: [number, number][] = [];
  const changes: boolean[] = [];
  const refused: string[] = [];
  const lock = new PointerLock(document, {
    look: (yaw, pitch) => looked.push([yaw, pitch]),
    wheel: () => undefined,
    changed: (locked) => changes.push(locked),
    refused: (why) => refused.push(why),
  });
  const move = (movementX: number, movementY: number) =>
    document.dispatchEvent(Object.assign(new Event("mousemove"), { movementX, movementY }));
  return { lock, element, requests, looked, changes, refused, move };
}

describe("PointerLock", () => {
  it("Mouse movement turns the tip while the pointer is locked, also without raw movement in the browser.", async () => {
    const { lock, element, requests, looked, changes, move } = page(["NotSupportedError"]);
    move(10, 10);
    await lock.request(element);
    expect(requests).toEqual([{ unadjustedMovement: true }, undefined]);
    expect(lock.locked).toBe(true);
    move(4, -2);
    expect(looked).toEqual([[4 * LOCK_RAD_PER_PX, 2 * LOCK_RAD_PER_PX]]);
    lock.release();
    move(4, 4);
    expect(looked).toHaveLength(1);
    expect(changes).toEqual([true, false]);
    lock.stop();
  });

  it("The browser's reason is reported when it refuses the lock.", async () => {
    const { lock, element, refused } = page(["SecurityError"]);
    await lock.request(element);
    expect(refused).toEqual(["no"]);
    expect(lock.locked).toBe(false);
    lock.stop();
  });
});
