/** Choices for a video of a flight, and the reasons why a video cannot be saved. */

import type { FlightInfo, KeyFramesMessage, ProgressMessage, RouteInfo, StateMessage } from "../wire/messages";

/** The flight that a video shows. */
export type FilmFlight =
  | { readonly kind: "route" }
  | { readonly kind: "key_frames" }
  | { readonly kind: "recording"; readonly number: number };

/** Widths and heights of a video in pixels, by the name of the size. */
export const FILM_SIZES = {
  small: { label: "640 \u00d7 480", width: 640, height: 480 },
  hd: { label: "1280 \u00d7 720", width: 1280, height: 720 },
  fullHd: { label: "1920 \u00d7 1080", width: 1920, height: 1080 },
  square: { label: "1080 \u00d7 1080", width: 1080, height: 1080 },
} as const;

/** Speeds in mm/s that the user can choose for a video along a route. */
export const FILM_SPEEDS_MM_S = [5, 10, 20, 40, 80] as const;
/** Frames per second of a video. */
export const FILM_RATE_HZ = 30;

/** Format, size, speed and captions of a video. */
export interface FilmChoice {
  readonly format: "mp4" | "webm";
  readonly size: keyof typeof FILM_SIZES;
  readonly speedMmS: number;
  readonly captions: boolean;
}

/** Choices before the user has changed them. */
export const FIRST_FILM: FilmChoice = { format: "mp4", size: "hd", speedMmS: 20, captions: true };

/** State of the page on which the videos depend. */
interface FilmState {
  readonly route: RouteInfo | null;
  readonly keyFrames: KeyFramesMessage | null;
  readonly flights: readonly FlightInfo[];
  readonly session: StateMessage | null;
  readonly jobs: readonly Pick<ProgressMessage, "title">[];
  readonly ui: { readonly filming: boolean };
}

/** Title of the server's job that renders a video. */
const FILM_JOB = "saving the video";

/** Return whether a video is being rendered: for this window, for another one, or for this page before a reload. */
export const isFilming = ({ jobs, ui }: Pick<FilmState, "jobs" | "ui">): boolean =>
  ui.filming || jobs.some(({ title }) => title === FILM_JOB);

/** Return the reason why no video of a flight can be saved now, as text for the user; null if one can be saved. */
export function filmProblem(state: FilmState, flight: FilmFlight): string | null {
  const { route, keyFrames, flights, session } = state;
  if (session?.case == null) return "Open a case first.";
  if (isFilming(state)) return "A video is being saved. Wait until it is complete, or cancel it.";
  switch (flight.kind) {
    case "route":
      return route === null ? "There is no route yet. Choose a branch, or mark a target." : null;
    case "key_frames":
      return (keyFrames?.duration_s ?? 0) > 0 ? null : "A flight needs at least two key frames.";
    case "recording": {
      const found = flights.find(({ number }) => number === flight.number);
      if (found === undefined) return "This flight has been removed.";
      if (found.state === "recording") return "Stop the recording first.";
      return found.length_s > 0 ? null : "This recording is empty.";
    }
  }
}

/** Return the query of the request for a video. */
export function filmQuery(window: number, flight: FilmFlight, choice: FilmChoice): string {
  const { width, height } = FILM_SIZES[choice.size];
  return new URLSearchParams({
    flight: flight.kind,
    ...(flight.kind === "recording" ? { number: String(flight.number) } : {}),
    format: choice.format,
    width: String(width),
    height: String(height),
    rate_hz: String(FILM_RATE_HZ),
    ...(flight.kind === "route" ? { speed_mm_s: String(choice.speedMmS) } : {}),
    captions: choice.captions ? "on" : "off",
    window: String(window),
  }).toString();
}

/** Return the name of the file of a video, which contains neither the patient nor the case. */
export function filmName(flight: FilmFlight, format: FilmChoice["format"]): string {
  switch (flight.kind) {
    case "route":
      return `flight.${format}`;
    case "key_frames":
      return `key-frames.${format}`;
    case "recording":
      return `recording-${flight.number}.${format}`;
  }
}

/** Return the job and file name of a video from the text that the tab has stored; null without a valid text. */
export function startedFilm(text: string | null): { readonly jobId: string; readonly name: string } | null {
  if (text === null) return null;
  try {
    const { jobId, name } = JSON.parse(text) as Record<string, unknown>;
    return typeof jobId === "string" && typeof name === "string" ? { jobId, name } : null;
  } catch {
    return null;
  }
}
