import { describe, expect, it } from "vitest";
import type { UncertainPlace } from "../wire/messages";
import { groupsOf } from "./uncertain";

const place = (words: string, branch_id: number | null = 1): UncertainPlace => ({ lps: [0, 0, 0], words, branch_id });

describe("places that could not be followed", () => {
  it("say a common reason once", () => {
    const groups = groupsOf([
      place("the lumen ends at 4.1 mm: mucus, or a narrowed airway", 1),
      place("lost where the lumen is 3.9 mm wide: its wall is too thin here", 2),
      place("the lumen ends at 3.2 mm: mucus, or a narrowed airway", 3),
    ]);
    expect(groups.map(({ why }) => why)).toEqual(["mucus, or a narrowed airway", null]);
    expect(groups[0]?.places.map(({ words }) => words)).toEqual([
      "the lumen ends at 4.1 mm",
      "the lumen ends at 3.2 mm",
    ]);
    expect(groups[1]?.places[0]?.words).toBe("lost where the lumen is 3.9 mm wide: its wall is too thin here");
  });

  it("keep words without a reason, and lose none", () => {
    const words = ["the volume ends here, the airway (6.0 mm wide) goes on", "below 2.1 mm: there are more", "a: b: c"];
    const groups = groupsOf(words.map((w) => place(w, null)));
    expect(groups.flatMap(({ places }) => places.map((p) => p.words))).toEqual(words);
  });
});
