import { expect, it } from "vitest";
import { citationLine } from "./citation";

it("citationLine contains authors, year, title, publisher, DOI, licence and changes in one line.", () => {
  const from = {
    authors: "Goldgof D, et al.",
    year: 2015,
    title: "Data From QIN_LUNG_CT",
    publisher: "The Cancer Imaging Archive",
    doi: "10.7937/K9/TCIA.2015.NPGZYZBZ",
    licence: "CC BY 3.0",
    changes: "cropped",
    collection: "QIN LUNG CT",
  };
  expect(citationLine(from)).toBe(
    "Goldgof D, et al. (2015). Data From QIN_LUNG_CT. The Cancer Imaging Archive. " +
      "https://doi.org/10.7937/K9/TCIA.2015.NPGZYZBZ \u00b7 Licence: CC BY 3.0. Changed: cropped.",
  );
});
