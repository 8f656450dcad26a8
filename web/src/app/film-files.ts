/** Videos of flights: the server renders them in a job, and the browser saves the finished file. */

import { DownloadError, fetchFilm, startFilm } from "../net/download";
import { type FilmFlight, filmName, filmProblem, filmQuery } from "../state/film";
import type { Station } from "./station";
import { saveAs } from "./station-parts";

/** Code of the error of a video that the user has cancelled. */
const CANCELLED = "export.video-stopped";

/** Save videos of flights. */
export class FilmFiles {
  readonly #station: Station;

  constructor(station: Station) {
    this.#station = station;
  }

  /** Open the dialog for the video of a flight; show the reason if there is no such flight. */
  open(flight: FilmFlight): void {
    const { state } = this.#station;
    const problem = filmProblem({ ...state, filming: state.ui.filming }, flight);
    if (problem === null) this.#station.ui({ film: flight });
    else this.#station.notice(problem);
  }

  /** Render the video of the dialog's flight with the chosen options, and save it when it is complete. */
  async save(): Promise<void> {
    const { state } = this.#station;
    const { film: flight, filmChoice: choice } = state.ui;
    if (flight === null || state.ui.filming) return;
    this.#station.ui({ film: null, filming: true });
    try {
      const jobId = await startFilm(filmQuery(state.window, flight, choice));
      const { name, blob } = await fetchFilm(jobId, filmName(flight, choice.format));
      saveAs(name, blob);
      this.#station.notice("Video saved.");
    } catch (error) {
      if (!(error instanceof DownloadError)) this.#show("download.failed", "The video could not be downloaded.");
      else if (error.code !== CANCELLED) this.#show(error.code, error.message);
    } finally {
      this.#station.ui({ filming: false });
    }
  }

  #show(code: string, message: string): void {
    this.#station.store.dispatch({ kind: "say", message: { kind: "error", code, message, action: null } });
  }
}
