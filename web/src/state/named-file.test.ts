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

describe("conflictChoices", () => {
  it("Without a conflict there is no choice, and namedPath returns the path of the file.", () => {
    expect(conflictChoices({ ...NAMED, beside: null })).toEqual({ beside: null, opens: false, replaces: false });
    expect(namedPath(NAMED)).toBe("/share/team.carina");
    expect(namedPath(NOTHING_SAVED)).toBeNull();
  });

  it("All three choices exist if the file contains another version of a case.", () => {
    for (const copy_conflict of ["changed", "other-case"] as const)
      expect(conflictChoices({ ...NAMED, copy_conflict })).toEqual({
        beside: "/share/team (2).carina",
        opens: true,
        replaces: true,
      });
  });

  it("A file that is missing or not a case cannot be opened, but can be replaced.", () => {
    for (const copy_conflict of ["not-a-case", "missing"] as const)
      expect(conflictChoices({ ...NAMED, copy_conflict })).toMatchObject({ opens: false, replaces: true });
  });

  it("A file that another window has open can be neither replaced nor opened.", () => {
    expect(conflictChoices({ ...NAMED, copy_conflict: "open-elsewhere" })).toMatchObject({
      beside: "/share/team (2).carina",
      opens: false,
      replaces: false,
    });
  });
});
