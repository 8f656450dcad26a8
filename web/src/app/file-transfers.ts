/** Uploads of files, which the server opens, and downloads of files of the open case. */

import {
  DownloadError,
  fetchAirways,
  fetchFlight,
  fetchFlightLog,
  fetchKeyFrames,
  fetchLearner,
  fetchPlan,
  planAddress,
} from "../net/download";
import { sendUpload, UploadError, type UploadFile } from "../net/upload";
import { caseKey } from "../state/case-key";
import { pathOfRecording } from "../state/expert";
import { expertFlight } from "../state/training";
import type { Station } from "./station";
import { saveAs } from "./station-parts";

/** File suffix of an exported plan. */
export type PlanSuffix = ".pdf" | ".json" | ".mrk.json" | ".seg.nrrd" | ".seg.dcm" | ".sr.dcm" | ".pdf.dcm";

/** Type of the message that opens uploaded files, by their purpose. */
const UPLOADED = {
  case: "open_upload",
  mask: "import_mask",
  keys: "open_key_frames",
  target: "import_target",
  movement: "measure_upload",
} as const;

/** Timeout of a download, ms. */
const DOWNLOAD_WITHIN_MS = 300_000;

/** Upload files for the open case, and download its files. */
export class FileTransfers {
  readonly #station: Station;
  #uploadStop: AbortController | null = null;

  constructor(station: Station) {
    this.#station = station;
  }

  /**
   * Upload files and open them: as another case, or as the airways, a target, the key frames or the second CT of the
   * open case.
   */
  async upload(
    files: readonly UploadFile[],
    use: keyof typeof UPLOADED = "case",
    { structure = null, targetId = null }: { structure?: string | null; targetId?: string | null } = {},
  ): Promise<void> {
    if (this.#station.state.watches) return;
    this.#uploadStop?.abort();
    const stop = new AbortController();
    this.#uploadStop = stop;
    const of = caseKey(this.#station.state.session);
    try {
      const id = await sendUpload(
        files,
        (upload) => this.#station.store.dispatch({ kind: "upload", upload }),
        stop.signal,
      );
      if (use !== "case" && caseKey(this.#station.state.session) !== of) {
        // The upload of a large file takes time. If the user has opened another case in the meantime, the mask must not
        // be applied to the other patient's scan.
        this.#showError(
          "upload.other-case",
          "Another case was opened during the upload, so the file was not used.",
          "Open the file again in the case it belongs to.",
        );
        return;
      }
      const type = UPLOADED[use];
      if (type === "import_target") this.#station.send({ type, upload_id: id, structure });
      else if (type !== "measure_upload") this.#station.send({ type, upload_id: id });
      else if (targetId !== null) this.#station.send({ type, upload_id: id, target_id: targetId });
    } catch (error) {
      if (stop.signal.aborted) return;
      if (error instanceof UploadError) this.#showError(error.code, error.message, error.action);
      else
        this.#showError(
          "upload.failed",
          "The files could not be sent to Carina.",
          "Check that Carina is still running.",
        );
    } finally {
      if (this.#uploadStop === stop) this.#station.store.dispatch({ kind: "upload", upload: null });
    }
  }

  cancelUpload = (): void => this.#uploadStop?.abort();

  /**
   * Download the airways in the format of this file suffix. Only one download runs at a time, because the server needs
   * seconds for a surface.
   */
  async takeAirways(suffix: string): Promise<void> {
    if (this.#station.state.ui.making !== null) return;
    this.#station.ui({ making: suffix });
    await this.#take(() => fetchAirways(suffix, AbortSignal.timeout(DOWNLOAD_WITHIN_MS)));
    this.#station.ui({ making: null });
  }

  async #take(fetched: () => Promise<{ name: string; blob: Blob }>): Promise<void> {
    try {
      const { name, blob } = await fetched();
      saveAs(name, blob);
    } catch (error) {
      if (error instanceof DownloadError) this.#showError(error.code, error.message, null);
      else
        this.#showError(
          "download.failed",
          "The file could not be downloaded from Carina.",
          "Check that Carina is still running.",
        );
    }
  }

  /** Download the key frames as a file from which `carina fly` renders a video. */
  async takeKeys(): Promise<void> {
    await this.#take(() => fetchKeyFrames(AbortSignal.timeout(DOWNLOAD_WITHIN_MS)));
  }

  /** Download a recorded flight of the case, by its number. */
  async takeFlight(number: number): Promise<void> {
    await this.#take(() => fetchFlight(number, AbortSignal.timeout(DOWNLOAD_WITHIN_MS)));
  }

  /** Download the log of a scored flight. */
  async takeFlightLog(number: number): Promise<void> {
    await this.#take(() => fetchFlightLog(number, AbortSignal.timeout(DOWNLOAD_WITHIN_MS)));
  }

  /** Load the path of the expert's flight, which a ghost in the airway view shows; null deletes the path. */
  async loadExpert(flight: number | null): Promise<void> {
    const station = this.#station;
    if (flight === null) return station.ui({ expertPath: null });
    try {
      const { blob } = await fetchFlight(flight, AbortSignal.timeout(DOWNLOAD_WITHIN_MS));
      const path = pathOfRecording(await blob.text());
      if (expertFlight(station.state) === flight) station.ui({ expertPath: { flight, path } });
    } catch {
      // Without the file no ghost is shown; the comparison is computed by the server.
      station.ui({ expertPath: null });
    }
  }

  /** Download the stored attempts of a learner. */
  async takeLearner(name: string): Promise<void> {
    await this.#take(() => fetchLearner(name, AbortSignal.timeout(DOWNLOAD_WITHIN_MS)));
  }

  /** Open the printable report of a plan in a new tab, from which the user prints it; a job shows the progress. */
  printPlan(targetId: string, kind: "report" | "tracing"): void {
    window.open(planAddress(targetId, ".html", kind), "_blank", "noopener");
  }

  /** Download the report of a target's plan in the format of this file suffix. */
  async takePlan(targetId: string, suffix: PlanSuffix, named = false): Promise<void> {
    if (this.#station.state.ui.making !== null) return;
    this.#station.ui({ making: `plan${suffix}` });
    await this.#take(() => fetchPlan(targetId, suffix, AbortSignal.timeout(DOWNLOAD_WITHIN_MS), named));
    this.#station.ui({ making: null });
  }

  #showError(code: string, message: string, action: string | null): void {
    this.#station.store.dispatch({ kind: "say", message: { kind: "error", code, message, action } });
  }
}
