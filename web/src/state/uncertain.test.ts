import { describe, expect, it } from "vitest";
import type { Uncertainty } from "../wire/messages";
import { groupsOf } from "./uncertain";

const place = (kind: Uncertainty["kind"], width_mm: number, more: Partial<Uncertainty> = {}): Uncertainty => ({
  lps: [0, 0, 0],
  kind,
  branch_id: 1,
  width_mm,
  confidence: null,
  num_ends: null,
  voxel_mm: null,
  ...more,
});

const plain = (words: string): string => words.replaceAll("\u202f", " ");

describe("places that could not be followed", () => {
  it("say once what all of a kind have in common", () => {
    const groups = groupsOf([place("blocked", 4.1), place("leak", 3.9), place("blocked", 3.2)]);
    expect(groups.map(({ why }) => why)).toEqual([
      "possibly mucus, a collapsed or narrowed airway, or a wall that the CT does not show",
      null,
    ]);
    expect(groups[0]?.places.map(({ words }) => plain(words))).toEqual([
      "the lumen ends where it is 4.1 mm wide",
      "the lumen ends where it is 3.2 mm wide",
    ]);
    expect(plain(groups[1]?.places[0]?.words ?? "")).toBe(
      "lost where the lumen is 3.9 mm wide: its wall is too thin here, and the search would have leaked into the lung",
    );
  });

  it("say it each by itself where they have nothing in common but their kind", () => {
    const groups = groupsOf([
      place("volume", 6),
      place("volume", 5),
      place("faint", 1.9, { confidence: 0.31 }),
      place("fine", 2.1, { branch_id: null, num_ends: 41, voxel_mm: 0.9 }),
    ]);
    expect(groups.map(({ why }) => why)).toEqual([null, null, null]);
    expect(groups.flatMap(({ places }) => places.map(({ words }) => plain(words)))).toEqual([
      "the scan ends here, but the airway (6.0 mm wide) continues",
      "the scan ends here, but the airway (5.0 mm wide) continues",
      "its wall is barely visible (confidence 0.31): it may not be an airway",
      "this CT (0.90 mm voxels) does not reliably show airways narrower than 2.1 mm, the median width at the 41 thinnest branch ends: there are smaller airways that are not shown",
    ]);
  });
});
