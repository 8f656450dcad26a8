import { describe, expect, it } from "vitest";
import { uploadProblem } from "./upload";

const file = (name: string, size: number) => ({ name, file: { size } });

describe("an upload", () => {
  it("is refused before anything is sent where it cannot be taken", () => {
    expect(uploadProblem([])?.code).toBe("upload.empty");
    expect(uploadProblem(Array.from({ length: 4097 }, (_, n) => file(`${n}`, 1)))?.code).toBe("upload.too-many");
    expect(uploadProblem([file("a", 3 * 2 ** 30)])?.message).toContain("a is 3.0 GiB");
    expect(uploadProblem([file("a", 1.5 * 2 ** 30), file("b", 1.5 * 2 ** 30), file("c", 1.5 * 2 ** 30)])?.code).toBe(
      "upload.too-large",
    );
  });

  it("goes ahead with an ordinary series", () => {
    expect(uploadProblem(Array.from({ length: 500 }, (_, n) => file(`${n}`, 525_000)))).toBeNull();
  });
});
