/** Downloads of files that Carina generates from the open case. */

/** Error of a failed download; its message is text for the user. */
export class DownloadError extends Error {
  constructor(
    readonly code: string,
    message: string,
  ) {
    super(message);
  }
}

/** Download the airways in the format of this file suffix (".stl"). */
export function fetchAirways(suffix: string, signal: AbortSignal): Promise<{ name: string; blob: Blob }> {
  return fetchFile(`airways${suffix}`, signal);
}

/** Return the address of the printable report of a target's plan. */
export function planAddress(targetId: string, suffix: ".html", kind: "report" | "tracing"): string {
  const query = kind === "tracing" ? "?kind=tracing" : "";
  return `./api/plans/${encodeURIComponent(targetId)}${suffix}${query}#print`;
}

/** Download the report of a target's plan in the format of this file suffix (".pdf"). */
export function fetchPlan(
  targetId: string,
  suffix: string,
  signal: AbortSignal,
  /** Whether a DICOM file contains the identity of the CT's patient; without effect on other formats. */
  named = false,
): Promise<{ name: string; blob: Blob }> {
  const query = named ? "?identity=ct" : "";
  return fetchFile(`${encodeURIComponent(targetId)}${suffix}`, signal, "plans/", query);
}

/** Download the key frames and their paths in the file format that `carina fly` reads. */
export function fetchKeyFrames(signal: AbortSignal): Promise<{ name: string; blob: Blob }> {
  return fetchFile(KEYS_FILE, signal);
}

/** Download a recorded flight of the case, by its number, in the file format that `carina fly` reads. */
export function fetchFlight(number: number, signal: AbortSignal): Promise<{ name: string; blob: Blob }> {
  return fetchFile(`flight-${number}.jsonl`, signal, "flights/");
}

/** Download the log of a scored flight: events, poses and scores as CSV, and xAPI statements, in one zip file. */
export function fetchFlightLog(number: number, signal: AbortSignal): Promise<{ name: string; blob: Blob }> {
  return fetchFile(`flight-${number}-log.zip`, signal, "flights/");
}

/** Download the stored attempts of a learner as CSV and xAPI statements, in a zip file. */
export function fetchLearner(name: string, signal: AbortSignal): Promise<{ name: string; blob: Blob }> {
  return fetchFile("learner.zip", signal, "course/", `?${new URLSearchParams({ name })}`);
}

/** Download a view as PNG, with the size and marks of the query. */
export function fetchPicture(view: string, query: string, signal: AbortSignal): Promise<{ name: string; blob: Blob }> {
  return fetchFile(`${view}.png`, signal, "pictures/", `?${query}`);
}

/** Download the contact sheet of the route's forks as PNG. */
export function fetchForks(signal: AbortSignal): Promise<{ name: string; blob: Blob }> {
  return fetchFile("forks.png", signal);
}

/** Start the job that renders a video, and return the ID of the job. */
export async function startFilm(query: string): Promise<string> {
  const response = await fetch(`./api/films?${query}`, { method: "POST" });
  if (!response.ok) throw await errorOf(response);
  const body: unknown = await response.json();
  const jobId = typeof body === "object" && body !== null ? (body as Record<string, unknown>).job_id : null;
  if (typeof jobId !== "string") throw new DownloadError("download.failed", "Carina did not start the video.");
  return jobId;
}

/** Pause before a failed request for a video is repeated, ms. */
const RETRY_MS = 2000;
/** Number of successive failed requests for a video after which the download fails. */
const MAX_FAILURES = 30;

/** Wait until the job of a video has ended, and download the video; requests that the network loses are repeated. */
export async function fetchFilm(
  jobId: string,
  name: string,
  pause: (ms: number) => Promise<void> = (ms) => new Promise((done) => setTimeout(done, ms)),
): Promise<{ name: string; blob: Blob }> {
  let failures = 0;
  for (;;) {
    try {
      const response = await fetch(`./api/films/${encodeURIComponent(jobId)}`);
      if (!response.ok) throw await errorOf(response);
      // The status 202 means that the video is not finished; the server answers after some seconds.
      if (response.status !== 202) return { name, blob: await response.blob() };
      await response.body?.cancel();
      failures = 0;
    } catch (error) {
      failures += 1;
      if (error instanceof DownloadError || failures >= MAX_FAILURES) throw error;
      await pause(RETRY_MS);
    }
  }
}

/** Name of the downloaded file of key frames. */
export const KEYS_FILE = "key-frames.json";

async function fetchFile(
  name: string,
  signal: AbortSignal,
  folder = "",
  query = "",
): Promise<{ name: string; blob: Blob }> {
  const response = await fetch(`./api/${folder}${name}${query}`, { signal });
  if (!response.ok) throw await errorOf(response);
  return { name, blob: await response.blob() };
}

/** Return the error of a response: its code and message, else its status. */
async function errorOf(response: Response): Promise<DownloadError> {
  const body: unknown = await response.json().catch(() => null);
  const field = (name: string): string | null => {
    const value = typeof body === "object" && body !== null ? (body as Record<string, unknown>)[name] : null;
    return typeof value === "string" ? value : null;
  };
  return new DownloadError(
    field("code") ?? "download.failed",
    field("message") ?? `The file could not be made (${response.status}).`,
  );
}
