import { afterEach, describe, expect, it, vi } from "vitest";
import { DownloadError, fetchAirways, fetchFilm } from "./download";

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

describe("fetchFilm", () => {
  const answers = (...all: (Response | Error)[]) => {
    vi.stubGlobal("fetch", async () => {
      const next = all.shift() ?? new TypeError("no network");
      if (next instanceof Error) throw next;
      return next;
    });
    return all;
  };

  it("The request is repeated while the video is unfinished, and after a request that the network lost.", async () => {
    const pauses: number[] = [];
    answers(new Response("{}", { status: 202 }), new TypeError("no network"), new Response("film"));
    const film = await fetchFilm("job-1", "flight.mp4", async (ms) => void pauses.push(ms));
    expect(await film.blob.text()).toBe("film");
    expect(pauses).toHaveLength(1);
  });

  it("A failed video is not requested again, and a network without an answer ends the download.", async () => {
    const left = answers(
      Response.json({ code: "export.video-gone", message: "gone" }, { status: 409 }),
      new Response(""),
    );
    await expect(fetchFilm("job-1", "a.mp4", async () => undefined)).rejects.toThrow("gone");
    expect(left).toHaveLength(1);
    answers();
    await expect(fetchFilm("job-1", "a.mp4", async () => undefined)).rejects.toThrow("no network");
  });
});
