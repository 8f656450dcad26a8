import { afterEach, describe, expect, it, vi } from "vitest";
import { DownloadError, fetchAirways } from "./download";

afterEach(() => vi.unstubAllGlobals());

const answer = (response: Response) => {
  const urls: string[] = [];
  vi.stubGlobal("fetch", async (url: string) => {
    urls.push(url);
    return response;
  });
  return urls;
};

describe("fetchAirways", () => {
  it("A download returns the file's name and contents.", async () => {
    const urls = answer(new Response("solid"));
    const file = await fetchAirways(".stl", new AbortController().signal);
    expect(urls).toEqual(["./api/airways.stl"]);
    expect(file.name).toBe("airways.stl");
    expect(await file.blob.text()).toBe("solid");
  });

  it("A refused download throws the server's code and message.", async () => {
    answer(Response.json({ code: "track.no-airways", message: "wait for them" }, { status: 409 }));
    const failed = fetchAirways(".stl", new AbortController().signal);
    await expect(failed).rejects.toEqual(new DownloadError("track.no-airways", "wait for them"));
  });

  it("A refused download without a message throws an error that contains the HTTP status.", async () => {
    answer(new Response("<html>", { status: 500 }));
    await expect(fetchAirways(".stl", new AbortController().signal)).rejects.toThrow("could not be made (500)");
  });
});
