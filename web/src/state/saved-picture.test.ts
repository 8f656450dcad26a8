import { describe, expect, it } from "vitest";
import { FIRST_PICTURE, markProblem, pictureName, pictureQuery, viewToSave } from "./saved-picture";
import { FIRST_SHOWN } from "./view-table";

describe("saved pictures", () => {
  it("A view in perspective cannot show a scale bar, and an X-ray cannot show names; both state the reason.", () => {
    expect(markProblem("axial", "scaleBar")).toBeNull();
    expect(markProblem("tree", "scaleBar")).toMatch(/no single scale/);
    expect(markProblem("xray-coronal", "names")).toMatch(/superimposes/);
    expect(markProblem("tri-plane", "names")).toMatch(/no single branches/);
    expect(markProblem("airway", "names")).toBeNull();
  });

  it("The name of a picture states the projection of an X-ray.", () => {
    expect(pictureName("xray-coronal")).toBe("X-ray (AP)");
    expect(pictureName("axial")).toBe("axial slice");
  });

  it("The key saves the focused view, else the full view, else the airway view.", () => {
    const shown = { ...FIRST_SHOWN, xray: "xray-axial" } as const;
    expect(viewToSave("tree", { full: "xray", shown })).toBe("tree");
    expect(viewToSave(null, { full: "xray", shown })).toBe("xray-axial");
    expect(viewToSave(null, { full: null, shown })).toBe("airway");
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
