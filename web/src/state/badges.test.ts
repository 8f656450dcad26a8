import { expect, test } from "vitest";
import { besideNotHu, findingsOf } from "./badges";

const NOT_HU = { code: "import.not-hu", words: "not HU: 8 bits", badge: true };
const CLIPPED = { code: "import.clipped", words: "9 voxels were clipped", badge: true };
const STOPPED = { code: "track.search-stopped", words: "the search was stopped", badge: true };

test("not HU has a badge of its own, all others are counted together", () => {
  expect(besideNotHu([NOT_HU, CLIPPED, STOPPED])).toEqual([CLIPPED, STOPPED]);
});

test("doubts come first, those of the airways too, and nothing is listed twice", () => {
  expect(findingsOf([NOT_HU, CLIPPED, STOPPED], ["slices are coarse"], [CLIPPED.words, "two series"])).toEqual([
    CLIPPED.words,
    STOPPED.words,
    "slices are coarse",
    "two series",
  ]);
});
