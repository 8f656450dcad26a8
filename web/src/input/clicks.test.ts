import { afterEach, beforeEach, describe, expect, it, vi } from "vitest";
import { ClickCounter, clickAction, DelayedAction } from "./clicks";

describe("clicks that follow each other", () => {
  it("are counted while they come at one place and without a pause", () => {
    const clicks = new ClickCounter();
    expect(clicks.count({ x: 10, y: 10 }, 0, "mouse")).toBe(1);
    expect(clicks.count({ x: 12, y: 10 }, 200, "mouse")).toBe(2);
    expect(clicks.count({ x: 12, y: 10 }, 400, "mouse")).toBe(3);
    expect(clicks.count({ x: 12, y: 10 }, 1000, "mouse")).toBe(1);
    expect(clicks.count({ x: 40, y: 10 }, 1100, "mouse")).toBe(1);
  });

  it("may lie farther apart under a finger than under a mouse", () => {
    const clicks = new ClickCounter();
    clicks.count({ x: 10, y: 10 }, 0, "finger");
    expect(clicks.count({ x: 30, y: 10 }, 100, "finger")).toBe(2);
    clicks.count({ x: 100, y: 10 }, 5000, "mouse");
    expect(clicks.count({ x: 120, y: 10 }, 5100, "mouse")).toBe(1);
  });

  it("begin anew after a drag", () => {
    const clicks = new ClickCounter();
    clicks.count({ x: 10, y: 10 }, 0, "mouse");
    clicks.forget();
    expect(clicks.count({ x: 10, y: 10 }, 100, "mouse")).toBe(1);
  });
});

describe("what a click is for", () => {
  it("is the tool once, and never a larger picture, however often it is clicked", () => {
    expect([1, 2, 3, 4].map((count) => clickAction(count, true))).toEqual(["click", "nothing", "nothing", "nothing"]);
  });

  it("without a tool is one choice, and each double click makes the picture large or small", () => {
    expect([1, 2, 3, 4].map((count) => clickAction(count, false))).toEqual(["click", "enlarge", "nothing", "enlarge"]);
  });
});

describe("an action that cannot be undone", () => {
  beforeEach(() => void vi.useFakeTimers());
  afterEach(() => void vi.useRealTimers());

  it("is done when no second click has come", () => {
    const action = new DelayedAction(300);
    const done = vi.fn();
    action.begin(done);
    vi.advanceTimersByTime(299);
    expect(done).not.toHaveBeenCalled();
    vi.advanceTimersByTime(1);
    expect(done).toHaveBeenCalledOnce();
  });

  it("is not done after a double click, which may tell that it came in time", () => {
    const action = new DelayedAction(300);
    const done = vi.fn();
    action.begin(done);
    expect(action.cancel()).toBe(true);
    vi.advanceTimersByTime(1000);
    expect(done).not.toHaveBeenCalled();
  });

  it("tells that a second click came too late, until another series begins", () => {
    const action = new DelayedAction(300);
    action.begin(() => undefined);
    vi.advanceTimersByTime(400);
    expect(action.cancel()).toBe(false);
    action.renew();
    expect(action.cancel()).toBe(true);
  });
});
