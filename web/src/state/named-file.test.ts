import { describe, expect, it } from "vitest";
import type { SavingInfo } from "../wire/messages";
import { conflictChoices, namedPath } from "./named-file";
import { NOTHING_SAVED } from "./saving.testing";

const NAMED: SavingInfo = {
  ...NOTHING_SAVED,
  copied_s: 0,
  copy_name: "team.carina",
  copy_folder: "/share",
  beside: "/share/team (2).carina",
};

describe("the choices for a named file", () => {
  it("offers nothing while the file is this window's own", () => {
    expect(conflictChoices({ ...NAMED, beside: null })).toEqual({ beside: null, opens: false, replaces: false });
    expect(namedPath(NAMED)).toBe("/share/team.carina");
    expect(namedPath(NOTHING_SAVED)).toBeNull();
  });

  it("offers all three where the file contains another version of a case", () => {
    for (const copy_conflict of ["changed", "other-case"] as const)
      expect(conflictChoices({ ...NAMED, copy_conflict })).toEqual({
        beside: "/share/team (2).carina",
        opens: true,
        replaces: true,
      });
  });

  it("does not open a file that is not a case, or is missing", () => {
    for (const copy_conflict of ["not-a-case", "missing"] as const)
      expect(conflictChoices({ ...NAMED, copy_conflict })).toMatchObject({ opens: false, replaces: true });
  });

  it("does not replace a file that another window has open", () => {
    expect(conflictChoices({ ...NAMED, copy_conflict: "open-elsewhere" })).toMatchObject({
      beside: "/share/team (2).carina",
      opens: false,
      replaces: false,
    });
  });
});
