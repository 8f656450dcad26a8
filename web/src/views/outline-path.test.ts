import { describe, expect, it } from "vitest";
import { outlineLines } from "./outline-path";

describe("outlineLines", () => {
  it("The bytes are decoded line after line, in sixteenths of a pixel.", () => {
    const numbers = [3, 16, 8, 24, 8, 16, 8, 1, 65_535, 0];
    const bytes = new Uint8Array(new Uint16Array(numbers).buffer);
    expect(outlineLines(bytes)).toEqual([
      [
        { column: 1, row: 0.5 },
        { column: 1.5, row: 0.5 },
        { column: 1, row: 0.5 },
      ],
      [{ column: 65_535 / 16, row: 0 }],
    ]);
    expect(outlineLines(new Uint8Array())).toEqual([]);
  });
});
