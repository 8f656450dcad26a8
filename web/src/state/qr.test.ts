import { describe, expect, it } from "vitest";
import { fingerprintLines, qrPath } from "./qr";

describe("qrPath", () => {
  it("The path covers exactly the dark modules.", () => {
    const rows = ["1011", "0000", "0110", "1111"];
    const dark = new Set<string>();
    for (const [, x, y, width] of qrPath(rows).matchAll(/M(\d+) (\d+)h(\d+)v1h-\3z/g)) {
      for (let n = 0; n < Number(width); n += 1) dark.add(`${Number(x) + n},${y}`);
    }
    const expected = rows.flatMap((row, y) => [...row].flatMap((bit, x) => (bit === "1" ? [`${x},${y}`] : [])));
    expect([...dark].sort()).toEqual(expected.sort());
  });
});

describe("fingerprintLines", () => {
  it("The four lines contain all bytes of the fingerprint in order.", () => {
    const sha256 = Array.from({ length: 32 }, (_, n) => n.toString(16).padStart(2, "0").toUpperCase()).join(":");
    const lines = fingerprintLines(sha256);
    expect(lines.length).toBe(4);
    expect(lines.join(" ").replaceAll(" ", ":")).toBe(sha256);
  });
});
