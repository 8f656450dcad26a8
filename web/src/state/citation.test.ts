import { describe, expect, it } from "vitest";
import { shortCitation } from "./citation";

describe("a citation", () => {
  it("is shortened to collection, licence and doi", () => {
    const text =
      "Goldgof D, et al. (2015). Data From QIN_LUNG_CT. The Cancer Imaging Archive. " +
      "https://doi.org/10.7937/K9/TCIA.2015.NPGZYZBZ. Licence: CC BY 3.0. Changed: cropped.";
    expect(shortCitation(text)).toEqual({ source: "QIN LUNG CT, CC BY 3.0", doi: "10.7937/K9/TCIA.2015.NPGZYZBZ" });
  });

  it("still leads to the whole text where it has none of these", () => {
    expect(shortCitation("Kindly lent by a colleague.")).toEqual({ source: "Source and licence", doi: null });
  });
});
