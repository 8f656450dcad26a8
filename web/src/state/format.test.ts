import { describe, expect, it } from "vitest";
import { carmWords, finenessWords, methodWords } from "./format";

describe("finenessWords", () => {
  it("The text states the share of the full width, and the ray step if it is longer than the finest.", () => {
    expect(finenessWords({ width: 240, step_vox: 0.5 }, 600)).toBe("reduced: 40 %");
    expect(finenessWords({ width: 150, step_vox: 1.4 }, 600)).toBe("reduced: 25 %, step 1.4 voxels");
    expect(finenessWords({ width: 600, step_vox: 0.5 }, 600)).toBe("full resolution");
  });

  it("A fine picture of half the wanted width is reported as reduced.", () => {
    expect(finenessWords({ width: 300, step_vox: 0.5 }, 600)).toBe("reduced: 50 %");
  });
});

describe("carmWords", () => {
  it("The angles are written in the notation of fluoroscopy: AP, LAO, RAO, CRAN, CAUD.", () => {
    expect(carmWords({ primary_deg: 0, secondary_deg: 0 })).toEqual(["AP 0\u00b0"]);
    expect(carmWords({ primary_deg: 30.4, secondary_deg: -15 })).toEqual(["LAO 30\u00b0", "CAUD 15\u00b0"]);
    expect(carmWords({ primary_deg: -90, secondary_deg: 8 })).toEqual(["RAO 90\u00b0", "CRAN 8\u00b0"]);
  });
});

describe("methodWords", () => {
  it("The text states the method of the displayed picture, and the requested method only if no picture exists.", () => {
    expect(methodWords("leap", "leap")).toBe("fast rendering");
    expect(methodWords("leap-all", "leap")).toBe("fast rendering");
    expect(methodWords("gpu-leap", "leap")).toBe("fast rendering");
    expect(methodWords("gpu-brute", "brute")).toBe("full sampling");
    expect(methodWords("brute", "leap")).toBe("full sampling until fast rendering is ready");
    expect(methodWords("plane", "leap")).toBe("cut-plane");
    expect(methodWords(null, "leap")).toBe("fast rendering");
  });
});
