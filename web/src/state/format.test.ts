import { describe, expect, it } from "vitest";
import { carmWords, finenessWords, methodWords } from "./format";

describe("how fine a picture is", () => {
  it("is said with its part of the resolution, and its step where that is longer", () => {
    expect(finenessWords({ width: 240, step_vox: 0.5 }, 600)).toBe("reduced: 40 %");
    expect(finenessWords({ width: 150, step_vox: 1.4 }, 600)).toBe("reduced: 25 %, step 1.4 voxels");
    expect(finenessWords({ width: 600, step_vox: 0.5 }, 600)).toBe("full resolution");
  });

  it("does not call a picture fine that was made for a smaller place", () => {
    expect(finenessWords({ width: 300, step_vox: 0.5 }, 600)).toBe("reduced: 50 %");
  });
});

describe("the angles of a C-arm", () => {
  it("are written as fluoroscopy writes them", () => {
    expect(carmWords({ primary_deg: 0, secondary_deg: 0 })).toEqual(["AP 0\u00b0"]);
    expect(carmWords({ primary_deg: 30.4, secondary_deg: -15 })).toEqual(["LAO 30\u00b0", "CAUD 15\u00b0"]);
    expect(carmWords({ primary_deg: -90, secondary_deg: 8 })).toEqual(["RAO 90\u00b0", "CRAN 8\u00b0"]);
  });
});

describe("how a picture was made", () => {
  it("is said of the picture on the screen, and not of what was asked for", () => {
    expect(methodWords("leap", "leap")).toBe("fast rendering");
    expect(methodWords("leap-all", "leap")).toBe("fast rendering");
    expect(methodWords("gpu-leap", "leap")).toBe("fast rendering");
    expect(methodWords("gpu-brute", "brute")).toBe("full sampling");
    expect(methodWords("brute", "leap")).toBe("full sampling until fast rendering is ready");
    expect(methodWords("plane", "leap")).toBe("cut-plane");
    expect(methodWords(null, "leap")).toBe("fast rendering");
  });
});
