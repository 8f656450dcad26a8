import { describe, expect, it } from "vitest";
import { FIRST_PICTURE, markProblem, pictureQuery } from "./saved-picture";

describe("saved pictures", () => {
  it("A view in perspective cannot show a scale bar, and an X-ray cannot show names; both state the reason.", () => {
    expect(markProblem("axial", "scaleBar")).toBeNull();
    expect(markProblem("tree", "scaleBar")).toMatch(/no single scale/);
    expect(markProblem("xray-coronal", "names")).toMatch(/no single branches/);
    expect(markProblem("airway", "names")).toBeNull();
  });

  it("The query contains the size on the screen, the factor and every mark.", () => {
    const query = pictureQuery(
      3,
      { width: 900, height: 700, fullWidth: 768 },
      { ...FIRST_PICTURE, scale: 2, names: false },
    );
    expect(query).toBe("window=3&width=900&height=700&full_width=768&scale=2&letters=on&scale_bar=on&names=off");
  });
});
