import { describe, expect, it } from "vitest";
import type { UncertainPlace } from "../wire/messages";
import { groupsOf } from "./uncertain";

const place = (kind: UncertainPlace["kind"], statement: string, explanation: string | null = null): UncertainPlace => ({
  lps: [0, 0, 0],
  kind,
  branch_id: 1,
  width_mm: 4,
  confidence: null,
  num_ends: null,
  voxel_mm: null,
  length_mm: null,
  calibre_mm: null,
  calibre_error_mm: null,
  beyond_lps: null,
  slice_number: 37,
  num_slices: 104,
  has_clips: false,
  statement,
  explanation,
});

describe("groupsOf", () => {
  it("Places of the same kind with the same explanation share one explanation.", () => {
    const groups = groupsOf([
      place("leak", "lost here, 4.1 mm wide", "its wall is too thin here"),
      place("lost", "lost here, 3.9 mm wide"),
      place("leak", "lost here, 3.2 mm wide", "its wall is too thin here"),
    ]);
    expect(groups.map(({ why }) => why)).toEqual(["its wall is too thin here", null]);
    expect(groups.map(({ places }) => places.map(({ words }) => words))).toEqual([
      ["lost here, 4.1 mm wide", "lost here, 3.2 mm wide"],
      ["lost here, 3.9 mm wide"],
    ]);
  });

  it("A single place has the explanation in its own text.", () => {
    const [group] = groupsOf([place("faint", "its wall is barely visible", "it may not be an airway")]);
    expect(group?.why).toBeNull();
    expect(group?.places[0]?.words).toBe("its wall is barely visible: it may not be an airway");
  });
});
