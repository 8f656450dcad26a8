import { afterEach, beforeEach, expect, test, vi } from "vitest";
import { ownWord } from "./own-word";

beforeEach(() => vi.useFakeTimers());
afterEach(() => vi.useRealTimers());

test("what was sent holds against older news, so that a second press goes on from the first", () => {
  let server = "radiograph";
  const tone = ownWord(() => server);
  tone.set("fluoroscopy");
  // A late message still tells what was before.
  expect(tone.now()).toBe("fluoroscopy");
  vi.advanceTimersByTime(599);
  expect(tone.now()).toBe("fluoroscopy");
  server = "fluoroscopy";
  expect(tone.now()).toBe("fluoroscopy");
});

test("after its time the server's word counts again: it may have refused", () => {
  const tone = ownWord(() => "radiograph");
  tone.set("fluoroscopy");
  vi.advanceTimersByTime(601);
  expect(tone.now()).toBe("radiograph");
});
