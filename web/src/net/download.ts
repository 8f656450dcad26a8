/** Files that Carina makes of the open case: fetched, then handed to the browser's own saving. */

/** Why there is no file, in words for a person. */
export class DownloadError extends Error {
  constructor(
    readonly code: string,
    message: string,
  ) {
    super(message);
  }
}

/** The airways as a file with this suffix (".stl"). */
export function fetchAirways(suffix: string, signal: AbortSignal): Promise<{ name: string; blob: Blob }> {
  return fetchFile(`airways${suffix}`, signal);
}

/** Where the report of a target's plan is shown, ready to be printed. */
export function planAddress(targetId: string, suffix: ".html", kind: "report" | "tracing"): string {
  const asked = kind === "tracing" ? "?kind=tracing" : "";
  return `./api/plans/${encodeURIComponent(targetId)}${suffix}${asked}#print`;
}

/** The plan of a target as a report with this suffix (".pdf"). */
export function fetchPlan(
  targetId: string,
  suffix: string,
  signal: AbortSignal,
  /** Of a DICOM file: whether it names the CT's patient. */
  named = false,
): Promise<{ name: string; blob: Blob }> {
  const asked = named ? "?identity=ct" : "";
  return fetchFile(`${encodeURIComponent(targetId)}${suffix}`, signal, "plans/", asked);
}

/** The key frames with their ways, as `carina fly` takes them. */
export function fetchKeyFrames(signal: AbortSignal): Promise<{ name: string; blob: Blob }> {
  return fetchFile(KEYS_FILE, signal);
}

/** A recorded flight of the case, as `carina fly` takes it. */
export function fetchFlight(number: number, signal: AbortSignal): Promise<{ name: string; blob: Blob }> {
  return fetchFile(`flight-${number}.jsonl`, signal, "flights/");
}

export const KEYS_FILE = "key-frames.json";

async function fetchFile(
  name: string,
  signal: AbortSignal,
  folder = "",
  asked = "",
): Promise<{ name: string; blob: Blob }> {
  const response = await fetch(`./api/${folder}${name}${asked}`, { signal });
  if (!response.ok) {
    const body: unknown = await response.json().catch(() => null);
    const field = (name: string): string | null => {
      const value = typeof body === "object" && body !== null ? (body as Record<string, unknown>)[name] : null;
      return typeof value === "string" ? value : null;
    };
    throw new DownloadError(
      field("code") ?? "download.failed",
      field("message") ?? `The file could not be made (${response.status}).`,
    );
  }
  return { name, blob: await response.blob() };
}
