/** Pictures of views as files: saved by the browser's download, or copied to the clipboard. */

import { DownloadError, fetchForks, fetchPicture } from "../net/download";
import { pictureQuery } from "../state/saved-picture";
import type { ViewName } from "../wire/messages";
import { LEAD_VIEW, VIEWS } from "../wire/views";
import type { Station } from "./station";
import { saveAs } from "./station-parts";

/** Timeout of a picture, ms. */
const WITHIN_MS = 120_000;
/** Timeout of the contact sheet, ms; its job shows the progress and can be cancelled. */
const FORKS_WITHIN_MS = 1_800_000;
/** Code of the error of a contact sheet that the user has cancelled. */
const CANCELLED = "plan.sheet-stopped";

interface NamedBlob {
  name: string;
  blob: Blob;
}

/** Save and copy pictures of views, which the server renders. */
export class PictureFiles {
  readonly #station: Station;

  constructor(station: Station) {
    this.#station = station;
  }

  /** Save a picture of a view through the browser's download. */
  async save(view: ViewName): Promise<void> {
    const made = this.#request(view);
    if (made === null) return;
    await this.#reporting(async () => {
      const { name, blob } = await made;
      saveAs(name, blob);
    });
  }

  /** Copy a picture of a view to the clipboard; where the browser does not allow it, save the picture. */
  async copy(view: ViewName): Promise<void> {
    const made = this.#request(view);
    if (made === null) return;
    await this.#reporting(async () => {
      if (await copied(made.then(({ blob }) => blob))) {
        this.#station.notice("Picture copied.");
        return;
      }
      const { name, blob } = await made;
      saveAs(name, blob);
      this.#station.notice("This browser does not allow copying, so the picture was saved.");
    });
  }

  /** Save one picture with all forks of the route. */
  async saveForks(): Promise<void> {
    if (this.#station.state.ui.makingForks) return;
    this.#station.ui({ makingForks: true });
    await this.#reporting(async () => {
      const { name, blob } = await fetchForks(AbortSignal.timeout(FORKS_WITHIN_MS));
      saveAs(name, blob);
    });
    this.#station.ui({ makingForks: false });
  }

  /** Save a picture of the focused view, or of the airway view if no view has the focus. */
  saveFocused(): void {
    void this.save(focusedView(this.#station) ?? LEAD_VIEW);
  }

  #request(view: ViewName): Promise<NamedBlob> | null {
    const { state, wall } = this.#station;
    const size = state.frames[view] === undefined ? null : (wall.find(view)?.screenPixels ?? null);
    if (size === null) {
      this.#station.notice(`There is no picture of the ${VIEWS[view].words} to save yet.`);
      return null;
    }
    return fetchPicture(view, pictureQuery(state.window, size, state.ui.picture), AbortSignal.timeout(WITHIN_MS));
  }

  async #reporting(work: () => Promise<void>): Promise<void> {
    try {
      await work();
    } catch (error) {
      const known = error instanceof DownloadError;
      if (known && error.code === CANCELLED) return;
      this.#station.store.dispatch({
        kind: "say",
        message: {
          kind: "error",
          code: known ? error.code : "download.failed",
          message: known ? error.message : "The picture could not be downloaded from Carina.",
          action: known ? null : "Check that Carina is still running.",
        },
      });
    }
  }
}

/** Return the view whose canvas has the focus; null if none has. */
function focusedView({ wall }: Station): ViewName | null {
  return wall.focused()?.view ?? null;
}

/** Copy a PNG to the clipboard; return false if the browser does not allow it. */
async function copied(png: Promise<Blob>): Promise<boolean> {
  if (typeof ClipboardItem === "undefined" || navigator.clipboard?.write === undefined) return false;
  try {
    // The item receives the promise, because the browser allows access only at once after the user's click.
    await navigator.clipboard.write([new ClipboardItem({ "image/png": png })]);
    return true;
  } catch {
    // A failed request is reported by the caller, which awaits the same promise.
    return false;
  }
}
