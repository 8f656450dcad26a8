import { describe, expect, it } from "vitest";
import type { Target } from "../wire/messages";
import {
  crossingsOf,
  crossingText,
  isSamePen,
  offeredCosts,
  pathText,
  penMessage,
  sliderLabel,
  startOf,
  targetMessage,
} from "./path-search";

const TARGET: Target = {
  target_id: "target-1",
  name: "Target 1",
  lps: [1, 2, 3],
  used_lps: [1, 2, 3],
  snapped_mm: 0,
  length_mm: 139.4,
  from_carina_mm: null,
  problem: null,
  cost: "walls",
  root_lps: [4, 5, 6],
  outside_mm: null,
  crossings_mm: null,
  note: "",
  priority: 1,
  has_size: false,
  value_range: [116, 140],
};
const NOTHING = { targets: [], root_lps: null };

describe("crossingsOf", () => {
  it("returns every crossing of the route's target, and the same empty list for any other route", () => {
    const crossings_mm = [1, 2, 3, 4, 5, 6, 7, 8];
    const targets = [
      { ...TARGET, target_id: "target-2" },
      { ...TARGET, crossings_mm },
    ];
    expect(crossingsOf("target-1", targets)).toBe(crossings_mm);
    expect(crossingsOf("target-2", targets)).toEqual([]);
    expect(crossingsOf(null, targets)).toBe(crossingsOf("target-9", []));
  });
});

describe("texts of the ruler", () => {
  const route = {
    origin: { kind: "ridge", along_mm: 100 },
    lumen_known: true,
    cumulative_mm: [0, 200],
    centreline_mm: [0, 200],
  } as unknown as Parameters<typeof sliderLabel>[0];

  it("The mark of a crossing has the origin of the ruler.", () => {
    expect(crossingText(route, 142)).toBe("Crosses the airway wall, 42\u202fmm past the main carina");
  });

  it("The label of the slider states the number of crossings.", () => {
    expect(sliderLabel(route, 0)).toBe("Position on the route in mm from the main carina");
    expect(sliderLabel(route, 1)).toMatch(/; the path crosses the airway wall once$/);
    expect(sliderLabel(route, 3)).toMatch(/3 times$/);
  });
});

describe("offeredCosts", () => {
  it("The selected cost function is always offered.", () => {
    expect(offeredCosts("lumen")).toEqual(["lumen", "walls"]);
    expect(offeredCosts("paper")).toEqual(["lumen", "walls", "paper"]);
  });
});

describe("startOf", () => {
  it("returns the marked start, else the start of the latest target with this cost, else the root of the airways", () => {
    const session = {
      targets: [TARGET, { ...TARGET, cost: "lumen" as const, root_lps: null }],
      root_lps: [7, 8, 9] as const,
    };
    expect(startOf({ pathCost: "walls", pathStart: [0, 0, 1] }, session)).toEqual([0, 0, 1]);
    expect(startOf({ pathCost: "walls", pathStart: null }, session)).toEqual([4, 5, 6]);
    expect(startOf({ pathCost: "walls", pathStart: null }, { ...session, targets: [] })).toEqual([7, 8, 9]);
    expect(startOf({ pathCost: "walls", pathStart: null }, NOTHING)).toBeNull();
  });
});

describe("targetMessage", () => {
  it("Through the lumen the command has neither a cost nor a start.", () => {
    const search = { pathCost: "lumen", pathStart: [0, 0, 1] } as const;
    expect(targetMessage([1, 2, 3], search, NOTHING)).toEqual({ type: "add_target", lps: [1, 2, 3] });
  });

  it("With another cost the command contains cost and start, and is null without a start.", () => {
    const search = { pathCost: "paper", pathStart: [0, 0, 1] } as const;
    const expected = { type: "add_target", lps: [1, 2, 3], cost: "paper", root_lps: [0, 0, 1] };
    expect(targetMessage([1, 2, 3], search, NOTHING)).toEqual(expected);
    expect(targetMessage([1, 2, 3], { ...search, pathStart: null }, NOTHING)).toBeNull();
  });
});

describe("penMessage", () => {
  it("names a tool that the pen can use, and for a target also its cost and start", () => {
    const search = { pathCost: "walls", pathStart: [0, 0, 1] } as const;
    expect(penMessage({ ...search, armed: "start" }, NOTHING)).toEqual({ type: "arm_pen", tool: "start" });
    expect(penMessage({ ...search, armed: "cut" }, NOTHING)).toEqual({ type: "arm_pen", tool: null });
    const target = penMessage({ ...search, armed: "target" }, NOTHING);
    expect(target).toEqual({ type: "arm_pen", tool: "target", cost: "walls", root_lps: [0, 0, 1] });
    expect(isSamePen(target, { ...target, root_lps: [0, 0, 1] })).toBe(true);
    expect(isSamePen(target, { ...target, root_lps: [0, 0, 2] })).toBe(false);
    expect(penMessage({ pathCost: "lumen", pathStart: null, armed: "target" }, NOTHING)).toEqual({
      type: "arm_pen",
      tool: "target",
    });
  });
});

describe("pathText", () => {
  it("The text of a path with a cost other than lumen states its range of values and its length outside the lumen.", () => {
    expect(pathText(TARGET, false)).toBe(
      "139\u202fmm from the start, cost walls, not compared with a lumen, values 116 to 140",
    );
    expect(pathText({ ...TARGET, outside_mm: 12.4, value_range: [-990, 40] }, true)).toBe(
      "139\u202fmm from the start, cost walls, 12\u202fmm outside the lumen, values -990 to 40 HU",
    );
    expect(pathText({ ...TARGET, outside_mm: 12.4, crossings_mm: [100.2, 112.6] }, false)).toContain(
      "12\u202fmm outside the lumen, crosses the wall 2 times, at 100\u202fmm, 113\u202fmm from the start, values",
    );
    const many = pathText({ ...TARGET, outside_mm: 30, crossings_mm: [1, 2, 3, 4, 5, 6, 7, 8] }, false);
    expect(many).toContain("crosses the wall 8 times, at 1\u202fmm, 2\u202fmm");
    expect(many).toContain("6\u202fmm, ... from the start");
    expect(pathText({ ...TARGET, outside_mm: 0, crossings_mm: [] }, false)).not.toContain("crosses");
    expect(pathText({ ...TARGET, outside_mm: 0 }, false)).toContain("all in the lumen");
  });

  it("The text of a path through the lumen states the distance of its end from the main carina, as plans do.", () => {
    const target = { ...TARGET, cost: "lumen" as const, root_lps: null, snapped_mm: 1.25, from_carina_mm: 27.6 };
    expect(pathText(target, true)).toBe("28\u202fmm past the main carina, moved 1.3\u202fmm into the lumen");
    expect(pathText({ ...target, from_carina_mm: -12, snapped_mm: 0 }, true)).toBe("12\u202fmm above the main carina");
    expect(pathText({ ...target, from_carina_mm: 0.2, snapped_mm: 0 }, true)).toBe("at the main carina");
    expect(pathText({ ...target, from_carina_mm: null, snapped_mm: 0 }, true)).toBe(
      "139\u202fmm from the start of the airway tree",
    );
    expect(pathText({ ...target, length_mm: null }, true)).toBe("");
  });
});
