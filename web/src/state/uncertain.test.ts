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
  length_mm: null,
  calibre_mm: null,
  calibre_error_mm: null,
  beyond_lps: null,
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

  it("say of what is filled how long, how wide from wall to wall, and that an airway lies beyond", () => {
    const groups = groupsOf([
      place("filled", 0, { length_mm: 11.6, calibre_mm: 6.44, calibre_error_mm: 0.6, beyond_lps: [1, 2, 3] }),
      place("filled", 2.3, { length_mm: 9 }),
    ]);
    expect(groups.map(({ why }) => why)).toEqual([
      "possibly secretions or a mucus plug; a CT cannot distinguish these from a tumour or a collapsed airway",
    ]);
    expect(groups[0]?.places.map(({ words }) => plain(words))).toEqual([
      "narrowed or filled here over 12 mm: no air is visible in a bronchus 6.4 ± 0.6 mm wide from wall to wall; there is an airway beyond it, which a bridge can reach",
      "narrowed or filled here over 9 mm: the air is 2.3 mm wide; its calibre from wall to wall cannot be measured here",
    ]);
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
