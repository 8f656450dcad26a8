/** Videos of flights: the server renders them in a job, and the browser saves the finished file. */

import { fetchFilm, startFilm } from "../net/download";
import { type FilmFlight, filmName, filmProblem, filmQuery, isFilming, startedFilm } from "../state/film";
import { downloadMessage } from "./download-message";
import type { Station } from "./station";
import { saveAs } from "./station-parts";

/** Key under which the tab stores the video that is being rendered, so that a reload of the page does not lose it. */
const STARTED = "carina.film";

/** Save videos of flights. */
export class FilmFiles {
  readonly #station: Station;

  constructor(station: Station) {
    this.#station = station;
  }

  /** Open the dialog for the video of a flight; show the reason if there is no such flight. */
  open(flight: FilmFlight): void {
    const { state } = this.#station;
    const problem = filmProblem(state, flight);
    if (problem === null) this.#station.ui({ film: flight });
    else this.#station.notice(problem);
  }

  /** Render the video of the dialog's flight with the chosen options, and save it when it is complete. */
  async save(): Promise<void> {
    const { state } = this.#station;
    const { film: flight, filmChoice: choice } = state.ui;
    if (flight === null || isFilming(state)) return;
    this.#station.ui({ film: null });
    await this.#save(() => startFilm(filmQuery(state.window, flight, choice)), filmName(flight, choice.format));
  }

  /** Save the video that this tab had started before the page was loaded again, when the video is complete. */
  async resume(): Promise<void> {
    const started = startedFilm(sessionStorage.getItem(STARTED));
    if (started === null || this.#station.state.ui.filming) return;
    await this.#save(async () => started.jobId, started.name);
  }

  async #save(start: () => Promise<string>, fileName: string): Promise<void> {
    this.#station.ui({ filming: true });
    let jobId: string | null = null;
    try {
      jobId = await start();
      sessionStorage.setItem(STARTED, JSON.stringify({ jobId, name: fileName }));
      const { name, blob } = await fetchFilm(jobId, fileName);
      saveAs(name, blob);
      this.#station.notice("Video saved.");
    } catch (error) {
      const isCancelledHere = jobId !== null && this.#station.state.cancelledJobs.includes(jobId);
      const message = downloadMessage(error, "The video", isCancelledHere);
      if (message !== null) this.#station.store.dispatch({ kind: "say", message });
    } finally {
      sessionStorage.removeItem(STARTED);
      this.#station.ui({ filming: false });
    }
  }
}
