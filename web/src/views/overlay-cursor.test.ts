import { describe, expect, it } from "vitest";
import { wrapped } from "./overlay-cursor";

describe("text at the cursor", () => {
  it("Text is broken between words into lines that fit, and a word that is too long has its own line.", () => {
    const fits = (line: string) => line.length <= 9;
    expect(wrapped("RB4 becomes RML", fits)).toEqual(["RB4", "becomes", "RML"]);
    expect(wrapped("the end of it", fits)).toEqual(["the end", "of it"]);
    expect(wrapped("a bronchioloalveolar one", fits)).toEqual(["a", "bronchioloalveolar", "one"]);
    expect(wrapped("", fits)).toEqual([""]);
  });
});
