import { expect, test } from "vitest";
import { findingsOf, isInserted, withoutHuNote } from "./badges";

const NOT_HU = { code: "import.not-hu", words: "not HU: 8 bits", badge: true };
const CLIPPED = { code: "import.clipped", words: "9 voxels were clipped", badge: true };
const STOPPED = { code: "track.search-stopped", words: "the search was stopped", badge: true };

test("withoutHuNote returns all notes except not HU, which has a separate badge.", () => {
  expect(withoutHuNote([NOT_HU, CLIPPED, STOPPED])).toEqual([CLIPPED, STOPPED]);
});

test("findingsOf lists doubts first, including those of the airways, and no text twice.", () => {
  expect(findingsOf([NOT_HU, CLIPPED, STOPPED], ["slices are coarse"], [CLIPPED.words, "two series"])).toEqual([
    CLIPPED.words,
    STOPPED.words,
    "slices are coarse",
    "two series",
  ]);
});

test("isInserted recognises the note on an inserted nodule alone.", () => {
  expect(
    [NOT_HU, CLIPPED, { code: "import.inserted", words: "inserted: a nodule", badge: true }].map(isInserted),
  ).toEqual([false, false, true]);
});
