import { describe, expect, it } from "vitest";
import { clock, passedKey } from "./playing";

describe("clock of a flight", () => {
  it("The time has minutes and tenths of seconds, and the seconds are never rounded to 60.", () => {
    expect([0, 7.46, 59.94, 59.96, 61, 725.3].map(clock)).toEqual([
      "0:00.0",
      "0:07.5",
      "0:59.9",
      "1:00.0",
      "1:01.0",
      "12:05.3",
    ]);
  });
});

describe("passedKey", () => {
  it("returns the last key frame whose time has been reached, and -1 for an empty list", () => {
    const keys = [{ time_s: 0 }, { time_s: 2 }, { time_s: 5 }];
    expect([0, 1.9, 1.995, 2, 4, 9].map((t) => passedKey(keys, t))).toEqual([0, 0, 1, 1, 1, 2]);
    expect(passedKey([], 1)).toBe(-1);
  });
});
