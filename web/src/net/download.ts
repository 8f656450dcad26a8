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
export async function fetchAirways(suffix: string, signal: AbortSignal): Promise<{ name: string; blob: Blob }> {
  const response = await fetch(`./api/airways${suffix}`, { signal });
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
  return { name: `airways${suffix}`, blob: await response.blob() };
}
