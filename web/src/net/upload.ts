/** Upload of dropped files to the Carina server, one file after the other, with progress. */

/** A file to upload, with its path. */
export interface UploadFile {
  /** Path of the file relative to the dropped item, with forward slashes. */
  readonly name: string;
  readonly file: File;
}

/** Error of a failed upload; its message is text for the user. */
export class UploadError extends Error {
  readonly code: string;
  readonly action: string | null;

  constructor(code: string, message: string, action: string | null) {
    super(message);
    this.code = code;
    this.action = action;
  }
}

/** Progress of an upload. */
export interface UploadProgress {
  sentBytes: number;
  totalBytes: number;
  numFiles: number;
}

/** Maximum number of files of an upload. */
const MAX_FILES = 4096;
/** Maximum total size in bytes of an upload. */
const MAX_BYTES = 4 * 2 ** 30;
/** Maximum size in bytes of one file of an upload. */
const MAX_FILE_BYTES = 2 * 2 ** 30;

/**
 * Return the error that prevents the upload of these files; null if they can be uploaded. The check precedes the upload
 * of the first file, because a partial folder is useless.
 */
export function uploadProblem(files: readonly { name: string; file: { size: number } }[]): UploadError | null {
  const giB = (bytes: number) => `${(bytes / 2 ** 30).toFixed(1)} GiB`;
  const wayOut = "Type the folder's path instead; the files are then not copied.";
  if (files.length === 0) return new UploadError("upload.empty", "There are no files to open.", null);
  if (files.length > MAX_FILES) {
    return new UploadError(
      "upload.too-many",
      `${files.length} files were chosen; at most ${MAX_FILES} can be opened at once.`,
      wayOut,
    );
  }
  const total = files.reduce((sum, entry) => sum + entry.file.size, 0);
  const big = files.find((entry) => entry.file.size > MAX_FILE_BYTES);
  if (total > MAX_BYTES || big !== undefined) {
    const what = big === undefined ? "The files total" : `${big.name} is`;
    const size = giB(big === undefined ? total : big.file.size);
    return new UploadError("upload.too-large", `${what} ${size}, which is too large to upload.`, wayOut);
  }
  return null;
}

async function refusal(response: Response): Promise<UploadError> {
  const body: unknown = await response.json().catch(() => null);
  const field = (name: string): string | null => {
    const value = typeof body === "object" && body !== null ? (body as Record<string, unknown>)[name] : null;
    return typeof value === "string" ? value : null;
  };
  return new UploadError(
    field("code") ?? "upload.failed",
    field("message") ?? `The upload was refused (${response.status}).`,
    field("action"),
  );
}

/**
 * Upload files one after the other; return the identifier of the upload for `open_upload`. If the upload fails or is
 * cancelled, the server's copy is deleted.
 */
export async function sendUpload(
  files: readonly UploadFile[],
  progress: (now: UploadProgress) => void,
  signal: AbortSignal,
): Promise<string> {
  const problem = uploadProblem(files);
  if (problem !== null) throw problem;
  const begun = await fetch("./api/upload", { method: "POST", signal });
  if (!begun.ok) throw await refusal(begun);
  const body: unknown = await begun.json();
  const id = (body as { upload_id?: unknown }).upload_id;
  if (typeof id !== "string") throw new UploadError("upload.failed", "The server did not accept the upload.", null);
  const address = `./api/upload/${encodeURIComponent(id)}`;
  const totalBytes = files.reduce((sum, entry) => sum + entry.file.size, 0);
  let sentBytes = 0;
  try {
    for (const { name, file } of files) {
      progress({ sentBytes, totalBytes, numFiles: files.length });
      const response = await fetch(`${address}?name=${encodeURIComponent(name)}`, {
        method: "PUT",
        body: file,
        signal,
      });
      if (!response.ok) throw await refusal(response);
      sentBytes += file.size;
    }
    progress({ sentBytes, totalBytes, numFiles: files.length });
    return id;
  } catch (error) {
    void fetch(address, { method: "DELETE" }).catch(() => undefined);
    throw error;
  }
}

/** Return all files of a drop, including the files in nested folders. */
export async function filesOfDrop(items: DataTransferItemList): Promise<UploadFile[]> {
  // Read the entries before the first await, because the browser clears the list when the drop event ends.
  const entries = [...items].map((item) => item.webkitGetAsEntry()).filter((entry) => entry !== null);
  const files: UploadFile[] = [];
  for (const entry of entries) await walk(entry, files);
  return files;
}

async function walk(entry: FileSystemEntry, files: UploadFile[]): Promise<void> {
  if (entry.isFile) {
    const file = await new Promise<File>((done, fail) => (entry as FileSystemFileEntry).file(done, fail));
    files.push({ name: entry.fullPath.replace(/^\//, ""), file });
    return;
  }
  const reader = (entry as FileSystemDirectoryEntry).createReader();
  // A directory reader returns at most 100 entries per call, and no entries after the last one.
  for (;;) {
    const part = await new Promise<FileSystemEntry[]>((done, fail) => reader.readEntries(done, fail));
    if (part.length === 0) return;
    for (const child of part) await walk(child, files);
  }
}

/** Return the files that the user selected in a file or folder dialog. */
export function filesOfPicker(list: FileList): UploadFile[] {
  return [...list].map((file) => ({ name: file.webkitRelativePath || file.name, file }));
}
