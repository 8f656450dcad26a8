import { describe, expect, it } from "vitest";
import type { LivePathMessage, TargetMarkMessage } from "../wire/messages";
import { type AppState, INITIAL_STATE } from "./app-state";
import { isMarkAt, marksStructure, targetMarkLines } from "./target-mark";

const NODULE: TargetMarkMessage = {
  type: "target_mark",
  request_id: 1,
  lps: [1, 2, 3],
  sentences: ["a click marks a solid nodule, 13.0 x 12.4 mm, 0.93 ml"],
  warns: false,
};

const path = (problem: string | null): AppState["livePath"] => ({
  answer: {
    type: "live_path",
    request_id: 1,
    lps: [1, 2, 3],
    points_lps: [],
    length_mm: problem === null ? 120 : null,
    from_carina_mm: problem === null ? 20 : null,
    min_diameter_mm: problem === null ? 4 : null,
    confidence: null,
    snapped_mm: null,
    new_mm: null,
    joins_branch_id: null,
    problem,
  } as LivePathMessage,
  tookMs: 5,
  overtaken: false,
});

const at = (change: Partial<AppState>, lps: [number, number, number] | null = [1, 2, 3]): AppState => ({
  ...INITIAL_STATE,
  livePath: path("soft tissue, not an airway"),
  ...change,
  ui: { ...INITIAL_STATE.ui, armed: "target", pointedLps: lps },
});

describe("what a click with Mark target would mark", () => {
  it("targetMarkLines states the nodule under the cursor instead of the absence of an airway.", () => {
    expect(targetMarkLines(at({ targetMark: NODULE }))).toEqual({
      lines: ["A click marks a solid nodule, 13.0 x 12.4 mm, 0.93 ml"],
      warns: false,
    });
    const doubted = { ...NODULE, sentences: [...NODULE.sentences, "doubt: it is long"], warns: true };
    expect(targetMarkLines(at({ targetMark: doubted }))).toEqual({
      lines: ["A click marks a solid nodule, 13.0 x 12.4 mm, 0.93 ml", "Doubt: it is long"],
      warns: true,
    });
  });

  it("targetMarkLines asks to rest the cursor until the answer for this point is known.", () => {
    const probed = { type: "value", lps: [1, 2, 3], voxel_value: 32 } as const;
    const waiting = {
      lines: ["A click measures what is here (32 HU).", "Rest the cursor to see the result first."],
      warns: false,
    };
    expect(targetMarkLines(at({ probed }))).toEqual(waiting);
    expect(targetMarkLines(at({ probed, targetMark: NODULE }, [9, 9, 9]))).toEqual(waiting);
    expect(targetMarkLines(at({ livePath: null }))).toBeNull();
  });

  it("targetMarkLines adds the path if the click marks the airway.", () => {
    const airway = { ...NODULE, sentences: ["a click marks this place in the airway"] };
    expect(targetMarkLines(at({ targetMark: airway, livePath: path(null) }))?.lines).toEqual([
      "A click marks this place in the airway",
      "20\u202fmm past the main carina",
      "fits up to 4.0\u202fmm",
    ]);
  });

  it("marksStructure is false for another tool and for a volume that is not in HU.", () => {
    const session = { case: { is_hu: true } } as unknown as AppState["session"];
    expect(marksStructure(at({ session }))).toBe(true);
    expect(marksStructure(at({ session: { case: { is_hu: false } } as unknown as AppState["session"] }))).toBe(false);
    expect(marksStructure({ ...INITIAL_STATE, session })).toBe(false);
    expect([isMarkAt(NODULE, [1, 2, 3.1]), isMarkAt(NODULE, [1, 2, 4]), isMarkAt(null, null)]).toEqual([
      true,
      false,
      false,
    ]);
  });
});
