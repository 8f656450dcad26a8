/** Pictures of views as files: saved by the browser's download, or copied to the clipboard. */

import { fetchForks, fetchPicture } from "../net/download";
import { pictureName, pictureQuery, viewToSave } from "../state/saved-picture";
import type { ViewName } from "../wire/messages";
import { downloadMessage } from "./download-message";
import type { Station } from "./station";
import { saveAs } from "./station-parts";

/** Timeout of a picture, ms. */
const WITHIN_MS = 120_000;
/** Timeout of the contact sheet, ms; its job shows the progress and can be cancelled. */
const FORKS_WITHIN_MS = 1_800_000;

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
    await this.#reporting("The picture", async () => {
      const { name, blob } = await this.#announced("Saving the picture\u2026", made);
      saveAs(name, blob);
    });
  }

  /** Copy a picture of a view to the clipboard; where the browser does not allow it, save the picture. */
  async copy(view: ViewName): Promise<void> {
    const made = this.#request(view);
    if (made === null) return;
    await this.#reporting("The picture", async () => {
      const png = () => made.then(({ blob }) => blob);
      if (await this.#announced("Copying the picture\u2026", copied(png))) {
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
    await this.#reporting("The picture of the forks", async () => {
      const { name, blob } = await fetchForks(AbortSignal.timeout(FORKS_WITHIN_MS));
      saveAs(name, blob);
    });
    this.#station.ui({ makingForks: false });
  }

  /** Save a picture of the focused view, else of the view in full view, else of the airway view. */
  saveFocused(): void {
    void this.save(viewToSave(focusedView(this.#station), this.#station.state.ui));
  }

  #request(view: ViewName): Promise<NamedBlob> | null {
    const { state, wall } = this.#station;
    const size = state.frames[view] === undefined ? null : (wall.find(view)?.screenPixels ?? null);
    if (size === null) {
      this.#station.notice(`There is no picture of the ${pictureName(view)} to save yet.`);
      return null;
    }
    return fetchPicture(view, pictureQuery(state.window, size, state.ui.picture), AbortSignal.timeout(WITHIN_MS));
  }

  /** Show a notice until a promise is settled, and return its value. */
  async #announced<T>(words: string, made: Promise<T>): Promise<T> {
    const id = this.#station.state.nextMessageId;
    this.#station.notice(words);
    try {
      return await made;
    } finally {
      this.#station.store.dispatch({ kind: "dismiss", id });
    }
  }

  async #reporting(subject: string, work: () => Promise<void>): Promise<void> {
    const before = this.#station.state.cancelledJobs.length;
    try {
      await work();
    } catch (error) {
      // The response contains no job ID, so any job that this window has cancelled meanwhile counts.
      const isCancelledHere = this.#station.state.cancelledJobs.length > before;
      const message = downloadMessage(error, subject, isCancelledHere);
      if (message !== null) this.#station.store.dispatch({ kind: "say", message });
    }
  }
}

/** Return the view whose canvas has the focus; null if none has. */
function focusedView({ wall }: Station): ViewName | null {
  return wall.focused()?.view ?? null;
}

/**
 * Copy a PNG to the clipboard; return false if the browser does not allow it. Without a clipboard the function `png` is
 * not called, because a promise that nothing awaits would report its rejection as unhandled.
 */
async function copied(png: () => Promise<Blob>): Promise<boolean> {
  if (typeof ClipboardItem === "undefined" || navigator.clipboard?.write === undefined) return false;
  try {
    // The item receives the promise, because the browser allows access only at once after the user's click.
    await navigator.clipboard.write([new ClipboardItem({ "image/png": png() })]);
    return true;
  } catch {
    // A failed request is reported by the caller, which awaits the same promise.
    return false;
  }
}
