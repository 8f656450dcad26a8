import { describe, expect, it } from "vitest";
import type { RecentCase, SavingInfo } from "../wire/messages";
import { caseFacts, changesText, continuedText, sizeText } from "./case-list";
import { clock } from "./format";
import { NOTHING_SAVED } from "./saving.testing";

const NOW_S = 1_800_000_000;
const NOW_MS = 1000 * NOW_S;
const ENTRY: RecentCase = {
  recent_id: "3f2a00ff00ff00ff",
  date: "2027-01-15",
  title: "Thorax 1.0 B60f",
  used_s: NOW_S,
  begun_s: NOW_S - 60,
  num_changes: 12,
  num_nodules: null,
  num_bytes: 1_830_912,
  picture: null,
  opens: true,
  scanned_on: null,
  named: false,
};
const SAVING: SavingInfo = { ...NOTHING_SAVED, continued_s: NOW_S, continued_changes: 12 };

describe("caseFacts", () => {
  it("The facts contain the number of changes and the last use.", () => {
    expect(caseFacts(ENTRY, [ENTRY], NOW_MS)).toEqual(["12 changes", `last used ${clock(NOW_S, NOW_MS)}`]);
    expect(changesText(0)).toBe("no changes");
    expect(changesText(1)).toBe("1 change");
  });

  it("The number of nodules precedes the changes, if it is known.", () => {
    expect(caseFacts({ ...ENTRY, num_nodules: 2 }, [], NOW_MS).slice(0, 2)).toEqual(["2 nodules", "12 changes"]);
    expect(caseFacts({ ...ENTRY, num_nodules: 0 }, [], NOW_MS)[0]).toBe("no nodules");
  });

  it("The scan date is the same day in every time zone.", () => {
    const dated = { ...ENTRY, scanned_on: "2021-05-03" };
    expect(caseFacts(dated, [dated], NOW_MS).slice(0, 2)).toEqual(["scan of 3 May 2021", "12 changes"]);
  });

  it("Two cases with the same title have a code that distinguishes them.", () => {
    const other = { ...ENTRY, recent_id: "77aa00ff00ff00ff" };
    expect(caseFacts(ENTRY, [ENTRY, other], NOW_MS).at(-1)).toBe("case 3f2a");
    expect(caseFacts(other, [ENTRY, other], NOW_MS).at(-1)).toBe("case 77aa");
  });

  it("A case without a record has only the day of its last use.", () => {
    expect(caseFacts({ ...ENTRY, num_changes: null, used_s: null }, [], NOW_MS)).toEqual(["last used 2027-01-15"]);
  });
});

describe("sizeText", () => {
  it.each([
    [0, "0\u202fMB"],
    [3, "1\u202fkB"],
    [999_400, "999\u202fkB"],
    [999_600, "1.0\u202fMB"],
    [1_830_912, "1.8\u202fMB"],
    [314_572_800, "315\u202fMB"],
    [2_147_483_648, "2.1\u202fGB"],
  ])("%d bytes are written as %s", (bytes, words) => {
    expect(sizeText(bytes)).toBe(words);
  });
});

describe("continuedText", () => {
  it("The notice is shown until the user closes it or changes the case.", () => {
    const notice = `Continued from ${clock(NOW_S, NOW_MS)}, 12 changes.`;
    expect(continuedText(SAVING, 12, null, NOW_MS)).toBe(notice);
    expect(continuedText(SAVING, 12, NOW_S - 1, NOW_MS)).toBe(notice);
    expect(continuedText(SAVING, 12, NOW_S, NOW_MS)).toBeNull();
    expect(continuedText(SAVING, 13, null, NOW_MS)).toBeNull();
  });

  it("The notice is null for a new case and for a case without changes.", () => {
    expect(continuedText(null, 0, null, NOW_MS)).toBeNull();
    expect(continuedText({ ...SAVING, continued_s: null }, 12, null, NOW_MS)).toBeNull();
    expect(continuedText({ ...SAVING, continued_changes: 0 }, 0, null, NOW_MS)).toBeNull();
  });
});
