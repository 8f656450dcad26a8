import { expect, test } from "vitest";
import { HELD_MS, held } from "./optimistic";

test("what was sent holds against older news, so that a second press goes on from the first", () => {
  let server = "radiograph";
  let nowMs = 0;
  const tone = held(
    () => server,
    () => nowMs,
  );
  tone.set("fluoroscopy");
  // A late message still tells what was before.
  expect(tone.now()).toBe("fluoroscopy");
  nowMs = HELD_MS - 1;
  expect(tone.now()).toBe("fluoroscopy");
  server = "fluoroscopy";
  expect(tone.now()).toBe("fluoroscopy");
});

test("after its time the server's word counts again: it may have refused", () => {
  let nowMs = 0;
  const tone = held(
    () => "radiograph",
    () => nowMs,
  );
  tone.set("fluoroscopy");
  nowMs = HELD_MS + 1;
  expect(tone.now()).toBe("radiograph");
});
