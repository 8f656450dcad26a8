import { afterEach, describe, expect, it, vi } from "vitest";
import { DownloadError, fetchAirways } from "./download";

afterEach(() => vi.unstubAllGlobals());

const answer = (response: Response) => {
  const asked: string[] = [];
  vi.stubGlobal("fetch", async (url: string) => {
    asked.push(url);
    return response;
  });
  return asked;
};

describe("a file to take away", () => {
  it("comes with its name", async () => {
    const asked = answer(new Response("solid"));
    const file = await fetchAirways(".stl", new AbortController().signal);
    expect(asked).toEqual(["./api/airways.stl"]);
    expect(file.name).toBe("airways.stl");
    expect(await file.blob.text()).toBe("solid");
  });

  it("is refused in the server's words", async () => {
    answer(Response.json({ code: "track.no-airways", message: "wait for them" }, { status: 409 }));
    const failed = fetchAirways(".stl", new AbortController().signal);
    await expect(failed).rejects.toEqual(new DownloadError("track.no-airways", "wait for them"));
  });

  it("is refused in words though the answer holds none", async () => {
    answer(new Response("<html>", { status: 500 }));
    await expect(fetchAirways(".stl", new AbortController().signal)).rejects.toThrow("could not be made (500)");
  });
});
