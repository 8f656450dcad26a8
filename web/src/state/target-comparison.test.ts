import { describe, expect, it } from "vitest";
import type { PlannedTargetRow } from "../wire/messages";
import { COMPARED_COLUMNS } from "./target-comparison";

const row: PlannedTargetRow = {
  target_id: "target-1",
  name: "Target 1",
  outlook: "may reach",
  route: "4 12.0 0",
  hit_share: 0.87,
  narrowest_mm: 4.14,
  narrowest_error_mm: 0.3,
  from_carina_mm: 81.2,
  to_target_mm: 9.5,
  vessel_mm: null,
  doubts: [],
};

const cells = (of: PlannedTargetRow) =>
  Object.fromEntries(COMPARED_COLUMNS.map(({ title, of: text }) => [title, text(of)]));

describe("comparison of targets", () => {
  it("COMPARED_COLUMNS state the figures of a row with their units.", () => {
    expect(cells(row)).toEqual({
      Outlook: "may reach",
      Hits: "87\u202f%",
      Narrowest: "4.1 \u00b1 0.3\u202fmm",
      "Past carina": "81\u202fmm",
      Needle: "10\u202fmm",
      Vessel: "none seen",
    });
    expect(cells({ ...row, vessel_mm: 2.26 }).Vessel).toBe("2.3\u202fmm");
    expect(cells({ ...row, vessel_mm: 0 }).Vessel).toBe("on the way");
  });

  it("COMPARED_COLUMNS have dashes for a target without a route, and never state that no vessel is seen.", () => {
    const none = { ...row, outlook: "no route", route: null, hit_share: null, narrowest_mm: null };
    const found = cells({ ...none, narrowest_error_mm: null, from_carina_mm: null, to_target_mm: null });
    expect(Object.values(found)).toEqual(["no route", ...Array(5).fill("\u2013")]);
  });
});
