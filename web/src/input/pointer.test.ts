// @vitest-environment jsdom
import { beforeEach, describe, expect, it, vi } from "vitest";
import { listenToPointer } from "./pointer";

const touch = (kind: string, pointerId: number, clientX: number, clientY: number): PointerEvent =>
  Object.assign(new MouseEvent(kind, { clientX, clientY, button: 0, bubbles: true }), {
    pointerId,
    pointerType: "touch",
  }) as unknown as PointerEvent;

describe("two fingers", () => {
  const element = document.createElement("div");
  const handlers = { pans: () => true, click: vi.fn(), drag: vi.fn(), release: vi.fn(), wheel: vi.fn() };
  let stop = () => {};
  beforeEach(() => {
    stop();
    vi.clearAllMocks();
    element.setPointerCapture = () => {};
    stop = listenToPointer(element, handlers);
  });

  const send = (...events: PointerEvent[]) => {
    for (const event of events) element.dispatchEvent(event);
  };

  it("zoom by their distance and pan by their middle", () => {
    send(touch("pointerdown", 1, 100, 100), touch("pointerdown", 2, 200, 100), touch("pointermove", 2, 300, 100));
    expect(handlers.wheel).toHaveBeenCalledWith(expect.closeTo(-Math.log(2) / 0.0015), true, { x: 200, y: 100 });
    expect(handlers.drag).toHaveBeenCalledWith({ x: 200, y: 100 }, { dx: 50, dy: 0 }, "pan", false);
  });

  it("are no click, and the finger that stays does not drag", () => {
    send(touch("pointerdown", 1, 100, 100), touch("pointerdown", 2, 200, 100), touch("pointerup", 2, 200, 100));
    send(touch("pointermove", 1, 150, 100), touch("pointerup", 1, 150, 100));
    expect(handlers.click).not.toHaveBeenCalled();
    expect(handlers.drag).not.toHaveBeenCalled();
    expect(handlers.release).toHaveBeenCalled();
  });

  it("leave one finger as before: a drag by finger, and a tap", () => {
    send(touch("pointerdown", 1, 100, 100), touch("pointermove", 1, 100, 120), touch("pointerup", 1, 100, 120));
    expect(handlers.drag).toHaveBeenCalledWith({ x: 100, y: 120 }, { dx: 0, dy: 20 }, "main", true);
    send(touch("pointerdown", 3, 50, 50), touch("pointerup", 3, 50, 50));
    expect(handlers.click).toHaveBeenCalledTimes(1);
  });
});
