import { describe, expect, it } from "vitest";
import type { MaskQuestion } from "../wire/messages";
import { firstChoice, labelTitle, lostText, questionText, questionTitle, volumeText } from "./mask-question";

const label: MaskQuestion = {
  title: "several.nrrd",
  problem: "label",
  labels: [
    { number: 1, name: "Lung", volume_ml: 4210.5 },
    { number: 7, name: null, volume_ml: 0.04 },
  ],
  suggested: null,
  expected: null,
  found: null,
  share_inside: null,
};
const grid: MaskQuestion = { ...label, problem: "grid", labels: [], expected: "a", found: "b", share_inside: 0.8 };

describe("texts about an imported mask", () => {
  it("The question states the file and the number of its structures, and asks for the airway lumen.", () => {
    expect(questionText(label)).toBe("several.nrrd contains 2 structures.");
    expect(questionTitle(label)).toContain("airway lumen");
    expect(label.labels.map(labelTitle)).toEqual(["Lung", "Label 7"]);
  });

  it("The initial choice is the server's suggestion, and null without one.", () => {
    expect(firstChoice(label)).toBeNull();
    expect(firstChoice({ ...label, suggested: 7 })).toBe(7);
  });

  it("volumeText writes volumes with enough digits to distinguish a bronchus from a lung.", () => {
    expect(volumeText(4210.5)).toBe("4,211\u202fml");
    expect(volumeText(3.25)).toBe("3.3\u202fml");
    expect(volumeText(0.04)).toBe("under 0.1\u202fml");
    expect(volumeText(0)).toBe("0.0\u202fml");
  });

  it("lostText states the share outside the scan as 1 to 99 %, and is null if nothing is outside.", () => {
    expect(questionTitle(grid)).toContain("scan");
    expect(lostText(grid)).toContain("20 % of it lies outside");
    expect(lostText({ ...grid, share_inside: 0.001 })).toContain("99 %");
    expect(lostText({ ...grid, share_inside: 0.994 })).toContain("1 %");
    expect(lostText({ ...grid, share_inside: 1 })).toBeNull();
    expect(lostText(label)).toBeNull();
  });
});
