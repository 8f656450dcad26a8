import { afterEach, beforeEach, describe, expect, it, vi } from "vitest";
import { ClickCounter, clickAction, DelayedAction } from "./clicks";

describe("ClickCounter", () => {
  it("Clicks at one place without a pause are counted as one series; a pause or a distance starts a new one.", () => {
    const clicks = new ClickCounter();
    expect(clicks.count({ x: 10, y: 10 }, 0, "mouse")).toBe(1);
    expect(clicks.count({ x: 12, y: 10 }, 200, "mouse")).toBe(2);
    expect(clicks.count({ x: 12, y: 10 }, 400, "mouse")).toBe(3);
    expect(clicks.count({ x: 12, y: 10 }, 1000, "mouse")).toBe(1);
    expect(clicks.count({ x: 40, y: 10 }, 1100, "mouse")).toBe(1);
  });

  it("Two clicks 20 px apart belong to one series for a finger, but not for a mouse.", () => {
    const clicks = new ClickCounter();
    clicks.count({ x: 10, y: 10 }, 0, "finger");
    expect(clicks.count({ x: 30, y: 10 }, 100, "finger")).toBe(2);
    clicks.count({ x: 100, y: 10 }, 5000, "mouse");
    expect(clicks.count({ x: 120, y: 10 }, 5100, "mouse")).toBe(1);
  });

  it("The count restarts at 1 after a drag.", () => {
    const clicks = new ClickCounter();
    clicks.count({ x: 10, y: 10 }, 0, "mouse");
    clicks.forget();
    expect(clicks.count({ x: 10, y: 10 }, 100, "mouse")).toBe(1);
  });
});

describe("clickAction", () => {
  it("With a tool the first click of a series applies the tool, and later clicks do nothing.", () => {
    expect([1, 2, 3, 4].map((count) => clickAction(count, true))).toEqual(["click", "nothing", "nothing", "nothing"]);
  });

  it("Without a tool the first click selects, and every second click enlarges or restores the picture.", () => {
    expect([1, 2, 3, 4].map((count) => clickAction(count, false))).toEqual(["click", "enlarge", "nothing", "enlarge"]);
  });
});

describe("DelayedAction", () => {
  beforeEach(() => void vi.useFakeTimers());
  afterEach(() => void vi.useRealTimers());

  it("The action runs when no second click has followed within the delay.", () => {
    const action = new DelayedAction(300);
    const done = vi.fn();
    action.begin(done);
    vi.advanceTimersByTime(299);
    expect(done).not.toHaveBeenCalled();
    vi.advanceTimersByTime(1);
    expect(done).toHaveBeenCalledOnce();
  });

  it("A second click within the delay cancels the action, and cancel() returns true.", () => {
    const action = new DelayedAction(300);
    const done = vi.fn();
    action.begin(done);
    expect(action.cancel()).toBe(true);
    vi.advanceTimersByTime(1000);
    expect(done).not.toHaveBeenCalled();
  });

  it("cancel() returns false after the action has run, and true again in a new series.", () => {
    const action = new DelayedAction(300);
    action.begin(() => undefined);
    vi.advanceTimersByTime(400);
    expect(action.cancel()).toBe(false);
    action.renew();
    expect(action.cancel()).toBe(true);
  });
});
