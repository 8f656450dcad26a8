import { describe, expect, it } from "vitest";
import { clock } from "./format";
import { savedText } from "./save-status";
import { NOTHING_SAVED } from "./saving.testing";

const NOW_S = 1_800_000_000;
const NOW_MS = 1000 * NOW_S;

describe("savedText", () => {
  it("The text states whether and when the open case was saved, and is null without a case.", () => {
    expect(savedText(null, NOW_MS)).toBeNull();
    expect(savedText(NOTHING_SAVED, NOW_MS)?.label).toBe("not changed");
    expect(savedText({ ...NOTHING_SAVED, saved_s: NOW_S }, NOW_MS)?.label).toBe(`saved ${clock(NOW_S, NOW_MS)}`);
  });

  it("The text states the named file and its folder, or why the file was not written.", () => {
    const copied = {
      ...NOTHING_SAVED,
      saved_s: NOW_S,
      copied_s: NOW_S,
      copy_name: "n.carina",
      copy_folder: "/data/Cases",
    };
    expect(savedText(copied, NOW_MS)?.label).toBe(
      `saved ${clock(NOW_S, NOW_MS)} \u00b7 copy from ${clock(NOW_S, NOW_MS)} in Cases`,
    );
    expect(
      savedText({ ...copied, copy_conflict: "changed", copy_problem: "n.carina was changed elsewhere" }, NOW_MS),
    ).toEqual({
      label: `saved ${clock(NOW_S, NOW_MS)}, not in n.carina`,
      words: "n.carina was changed elsewhere",
      warns: true,
    });
    expect(savedText({ ...copied, copy_problem: "the stick was removed" }, NOW_MS)).toMatchObject({
      warns: true,
      words: "the stick was removed",
    });
  });

  it("A failed or disabled save is always shown as a warning.", () => {
    const shown = savedText({ ...NOTHING_SAVED, saved_s: NOW_S, problem: "the disk is full" }, NOW_MS);
    expect(shown).toMatchObject({ warns: true, words: "the disk is full" });
    expect(shown?.label).toContain(clock(NOW_S, NOW_MS));
    const elsewhere = { copied_s: NOW_S + 60, copy_name: "n.carina", copy_folder: "/media/stick" };
    expect(
      savedText({ ...NOTHING_SAVED, saved_s: NOW_S, problem: "the disk is full", ...elsewhere }, NOW_MS),
    ).toMatchObject({
      warns: true,
      label: `cannot save on this machine \u00b7 copy from ${clock(NOW_S + 60, NOW_MS)} in stick`,
    });
    expect(savedText({ ...NOTHING_SAVED, keeps: false }, NOW_MS)).toMatchObject({ warns: true, label: "not saved" });
  });

  it("A time on another day has a date.", () => {
    expect(clock(0, Date.UTC(2026, 0, 31))).toMatch(/^(1969-12-31|1970-01-01) \d\d:\d\d$/);
    expect(clock(NOW_S, NOW_MS)).toMatch(/^\d\d:\d\d$/);
  });
});
