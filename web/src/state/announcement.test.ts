import { describe, expect, it } from "vitest";
import { announcementOf } from "./announcement";
import type { ForkAhead } from "./fork";
import { wrongBranchText } from "./wrong-branch";

const way = (id: number, label: string, hour: number | null, chosen: boolean) => ({
  node: { branch: { id }, label },
  chosen,
  hour,
  noHour: hour === null ? "straight ahead" : null,
  across: 0,
});
const fork = (distanceMm: number, near = true): ForkAhead =>
  ({ distanceMm, near, ways: [way(1, "LMB", 9, false), way(2, "RMB", null, true)] }) as unknown as ForkAhead;

describe("announcementOf", () => {
  it("states the fork, its branches with their directions, and the route", () => {
    const { text } = announcementOf({ fork: fork(12), atEnd: false, wrong: null }) ?? { text: "" };
    expect(text).toBe("Fork in 12\u202fmm: LMB, 9 o\u2019clock; RMB, straight ahead, your route.");
  });

  it("has the same key while the distance changes, so that a fork is announced once", () => {
    const key = (mm: number) => announcementOf({ fork: fork(mm), atEnd: false, wrong: null })?.key;
    expect(key(12)).toBe(key(3));
    expect(announcementOf({ fork: fork(12, false), atEnd: false, wrong: null })).toBeNull();
  });

  it("states a wrong branch before everything else", () => {
    const wrong = wrongBranchText({ back_to_route_mm: 12.4, branch_id: null, branch_name: "LB9" }, null);
    expect(wrong).toEqual({ branch: "LB9", back: "12\u202fmm" });
    expect(announcementOf({ fork: fork(2), atEnd: true, wrong })?.text).toBe(
      "Wrong branch: you are in LB9. Go back 12\u202fmm.",
    );
    expect(wrongBranchText({ back_to_route_mm: null, branch_id: 3, branch_name: "LB9" }, null)).toBeNull();
  });
});
