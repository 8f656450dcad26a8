import { describe, expect, it } from "vitest";
import { carmText, finenessText, methodText, seriesFacts, seriesTitle } from "./format";

describe("finenessText", () => {
  it("The text states the share of the full width, and the ray step if it is longer than the finest.", () => {
    expect(finenessText({ width: 240, step_vox: 0.5 }, 600)).toBe("reduced: 40 %");
    expect(finenessText({ width: 150, step_vox: 1.4 }, 600)).toBe("reduced: 25 %, step 1.4 voxels");
    expect(finenessText({ width: 600, step_vox: 0.5 }, 600)).toBe("full resolution");
  });

  it("A fine picture of half the wanted width is reported as reduced.", () => {
    expect(finenessText({ width: 300, step_vox: 0.5 }, 600)).toBe("reduced: 50 %");
  });
});

describe("carmText", () => {
  it("The angles are written in the words of a plan: AP, LAO, RAO, cranial, caudal.", () => {
    expect(carmText({ primary_deg: 0, secondary_deg: 0 })).toEqual(["AP"]);
    expect(carmText({ primary_deg: 30.4, secondary_deg: -15 })).toEqual(["LAO 30\u00b0", "caudal 15\u00b0"]);
    expect(carmText({ primary_deg: -90, secondary_deg: 8 })).toEqual(["RAO 90\u00b0", "cranial 8\u00b0"]);
  });
});

describe("methodText", () => {
  it("The text states the method of the displayed picture, and the requested method only if no picture exists.", () => {
    expect(methodText("leap", "leap")).toBe("fast rendering");
    expect(methodText("leap-all", "leap")).toBe("fast rendering");
    expect(methodText("gpu-leap", "leap")).toBe("fast rendering");
    expect(methodText("gpu-brute", "brute")).toBe("full sampling");
    expect(methodText("brute", "leap")).toBe("full sampling until fast rendering is ready");
    expect(methodText("plane", "leap")).toBe("cut-plane");
    expect(methodText(null, "leap")).toBe("fast rendering");
  });
});

describe("seriesFacts", () => {
  const series = {
    modality: "CT",
    description: "Thorax, reconstruction kernel b41f",
    num_slices: 300,
    slice_distance_mm: 0.7,
    thickness_mm: 1,
    kernel: "b41f",
    phase: "breathing 50 %",
    acquired_on: "2026-11-30",
  };
  it("A series is described by its slices, phase and date, without a second mention of its kernel.", () => {
    expect(seriesTitle(series)).toBe("Thorax, reconstruction kernel b41f");
    expect(seriesFacts(series)).toBe("300 slices, every 0.70\u202fmm, 1.00\u202fmm thick, breathing 50 %, 2026-11-30");
  });
  it("Facts that a series does not state are left out.", () => {
    const bare = {
      ...series,
      description: "",
      slice_distance_mm: null,
      thickness_mm: null,
      phase: "",
      acquired_on: null,
    };
    expect(seriesTitle(bare)).toBe("CT");
    expect(seriesFacts({ ...bare, num_slices: 1 })).toBe("1 slice, kernel b41f");
  });
});
