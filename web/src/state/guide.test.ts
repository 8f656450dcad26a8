import { describe, expect, it } from "vitest";
import { INITIAL_STATE } from "./app-state";
import { HINTS, hintsDue, TOUR } from "./guide";
import { cardPlace } from "./guide-place";

const state = (read: boolean, airways: string, tourAt: number | null = null) =>
  ({
    ...INITIAL_STATE,
    start: { hints_read: read, notice_accepted: true },
    session: { case: {}, airways },
    ui: { ...INITIAL_STATE.ui, tourAt },
  }) as unknown as typeof INITIAL_STATE;

describe("hintsDue", () => {
  it("shows the hints once the airways of a case are found, until the user has read them", () => {
    expect(hintsDue(state(false, "found"))).toBe(true);
    expect(hintsDue(state(true, "found"))).toBe(false);
    expect(hintsDue(state(false, "finding"))).toBe(false);
    expect(hintsDue(INITIAL_STATE)).toBe(false);
  });

  it("shows no hint during the tour and in a window that only watches", () => {
    expect(hintsDue(state(false, "found", 0))).toBe(false);
    expect(hintsDue({ ...state(false, "found"), watches: true })).toBe(false);
  });

  it("shows no hint during a quiz", () => {
    const training = { running: null, quiz: {}, tasks: [] } as unknown as (typeof INITIAL_STATE)["training"];
    expect(hintsDue({ ...state(false, "found"), training })).toBe(false);
  });
});

describe("the texts of hints and tour", () => {
  it("are three hints, and a tour that takes about two minutes at 200 words a minute with time to look", () => {
    expect(HINTS).toHaveLength(3);
    const words = TOUR.flatMap((stop) => `${stop.title} ${stop.words}`.split(" ")).length;
    const seconds = (words / 200) * 60 + 8 * TOUR.length;
    expect(seconds).toBeGreaterThan(90);
    expect(seconds).toBeLessThan(150);
  });
});

describe("cardPlace", () => {
  it("puts the card beside its element, and never outside the window", () => {
    expect(cardPlace({ left: 0, top: 100, width: 300, height: 400 }, 1280, 720)).toEqual({ left: 312, top: 100 });
    for (const box of [
      null,
      { left: 1200, top: 10, width: 60, height: 24 },
      { left: 0, top: 640, width: 1280, height: 56 },
      { left: 0, top: 0, width: 1280, height: 720 },
    ]) {
      const { left, top } = cardPlace(box, 1280, 720);
      expect(left).toBeGreaterThanOrEqual(0);
      expect(left).toBeLessThanOrEqual(1280 - 300);
      expect(top).toBeGreaterThanOrEqual(0);
      expect(top).toBeLessThanOrEqual(720 - 180);
    }
  });
});
