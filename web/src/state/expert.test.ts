import { describe, expect, it } from "vitest";
import { ghostAhead, pathOfRecording, placeOnPath } from "./expert";
import type { Vec3 } from "./vec";

const pose = (x: number) => [1, 0, 0, x, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];
const line = (x: number) => JSON.stringify({ t: x, move: {}, pose: pose(x) });
/** Into a branch of 20 mm and back. */
const THERE_AND_BACK: Vec3[] = [
  ...Array.from({ length: 21 }, (_, n) => n),
  ...Array.from({ length: 20 }, (_, n) => 19 - n),
].map((x) => [x, 0, 0]);

describe("expert's path", () => {
  it("Positions of a recording are read, without repeated and damaged ones.", () => {
    const text = ['{"format":"carina-recording"}', line(0), line(0.1), line(2), '{"pose":[1]}', '{"pose":'].join("\n");
    expect(pathOfRecording(text)).toEqual([
      [0, 0, 0],
      [2, 0, 0],
    ]);
  });

  it("The place on the path is the pass at or after the previous place.", () => {
    expect(placeOnPath(THERE_AND_BACK, [6, 1, 0], 0)).toBe(6);
    expect(placeOnPath(THERE_AND_BACK, [6, 1, 0], 20)).toBe(34);
    expect(placeOnPath(THERE_AND_BACK, [6, 30, 0], 0)).toBeNull();
  });

  it("The ghost is 10 mm ahead of the place, on the way that the expert took from there.", () => {
    expect(ghostAhead(THERE_AND_BACK, 6)).toEqual([16, 0, 0]);
    expect(ghostAhead(THERE_AND_BACK, 34)).toEqual([0, 0, 0]);
  });
});
