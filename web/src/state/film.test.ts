import { describe, expect, it } from "vitest";
import type { FlightInfo, RouteInfo } from "../wire/messages";
import { INITIAL_STATE } from "./app-state";
import { FIRST_FILM, filmName, filmProblem, filmQuery, startedFilm } from "./film";

const session = { case: {} } as unknown as NonNullable<typeof INITIAL_STATE.session>;
const open = { ...INITIAL_STATE, session };

describe("videos", () => {
  it("A video without its flight, or beside another video, states the reason.", () => {
    expect(filmProblem(INITIAL_STATE, { kind: "route" })).toMatch(/Open a case/);
    expect(filmProblem(open, { kind: "route" })).toMatch(/no route/);
    expect(filmProblem(open, { kind: "key_frames" })).toMatch(/two key frames/);
    expect(filmProblem(open, { kind: "recording", number: 1 })).toMatch(/removed/);
    const route = {} as RouteInfo;
    expect(filmProblem({ ...open, route }, { kind: "route" })).toBeNull();
    const filming = { ...open, route, ui: { ...open.ui, filming: true } };
    expect(filmProblem(filming, { kind: "route" })).toMatch(/being saved/);
    // Another window, or this page before a reload, has started a video.
    expect(filmProblem({ ...open, route, jobs: [{ title: "saving the video" }] }, { kind: "route" })).toMatch(
      /being saved/,
    );
  });

  it("A recording that is not complete has no video.", () => {
    const flights = [{ number: 1, state: "recording", length_s: 4 }] as unknown as FlightInfo[];
    expect(filmProblem({ ...open, flights }, { kind: "recording", number: 1 })).toMatch(/Stop the recording/);
  });

  it("A stored video is read, and an invalid text is ignored.", () => {
    expect(startedFilm('{"jobId":"job-3","name":"flight.mp4"}')).toEqual({ jobId: "job-3", name: "flight.mp4" });
    expect(["{", "null", "3", '{"jobId":3}', null].map(startedFilm)).toEqual([null, null, null, null, null]);
  });

  it("The query contains the speed of a route only, and the number of a recording only.", () => {
    expect(filmQuery(2, { kind: "route" }, FIRST_FILM)).toBe(
      "flight=route&format=mp4&width=1280&height=720&rate_hz=30&speed_mm_s=20&captions=on&window=2",
    );
    const recorded = new URLSearchParams(filmQuery(2, { kind: "recording", number: 7 }, FIRST_FILM));
    expect(recorded.get("number")).toBe("7");
    expect(recorded.has("speed_mm_s")).toBe(false);
    expect(filmName({ kind: "recording", number: 7 }, "webm")).toBe("recording-7.webm");
  });
});
