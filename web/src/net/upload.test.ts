import { describe, expect, it } from "vitest";
import { uploadProblem } from "./upload";

const file = (name: string, size: number) => ({ name, file: { size } });

describe("uploadProblem", () => {
  it("An upload of no files, of too many files, of a file that is too large, or with a total that is too large is refused.", () => {
    expect(uploadProblem([])?.code).toBe("upload.empty");
    expect(uploadProblem(Array.from({ length: 4097 }, (_, n) => file(`${n}`, 1)))?.code).toBe("upload.too-many");
    expect(uploadProblem([file("a", 3 * 2 ** 30)])?.message).toContain("a is 3.0 GiB");
    expect(uploadProblem([file("a", 1.5 * 2 ** 30), file("b", 1.5 * 2 ** 30), file("c", 1.5 * 2 ** 30)])?.code).toBe(
      "upload.too-large",
    );
  });

  it("returns null for a CT series of 500 files", () => {
    expect(uploadProblem(Array.from({ length: 500 }, (_, n) => file(`${n}`, 525_000)))).toBeNull();
  });
});
