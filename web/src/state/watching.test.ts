import { describe, expect, it } from "vitest";
import { FIRST_SIGHT } from "../wire/messages";
import { mayWatcherSend, watchingText } from "./watching";

describe("window that only watches", () => {
  it("may send its own view settings and queries, and no other message", () => {
    expect(mayWatcherSend({ type: "set_crosshair", lps: null })).toBe(true);
    expect(mayWatcherSend({ type: "set_carm", ...FIRST_SIGHT.carm })).toBe(true);
    expect(mayWatcherSend({ type: "probe", lps: [0, 0, 0] })).toBe(true);
    for (const type of ["undo", "close_case", "accept_notice", "ask_storage", "toggle_mode"] as const) {
      expect(mayWatcherSend({ type })).toBe(false);
    }
    expect(mayWatcherSend({ type: "set_fov", fov_deg: 90 })).toBe(false);
  });

  it("The top bar states the number of watchers.", () => {
    const page = { url: "", address: "", sha256: "", num_refused: 0, watchers: [], learners: false };
    const watcher = { number: 1, address: "192.0.2.1", since_s: 0 };
    expect(watchingText(page)).toBe("on the network");
    expect(watchingText({ ...page, watchers: [watcher] })).toBe("1 person watching");
    expect(watchingText({ ...page, watchers: [watcher, { ...watcher, number: 2 }] })).toBe("2 people watching");
  });
});
