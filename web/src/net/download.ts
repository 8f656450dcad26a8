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

/** Name of the downloaded file of key frames. */
export const KEYS_FILE = "key-frames.json";

async function fetchFile(
  name: string,
  signal: AbortSignal,
  folder = "",
  query = "",
): Promise<{ name: string; blob: Blob }> {
  const response = await fetch(`./api/${folder}${name}${query}`, { signal });
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
