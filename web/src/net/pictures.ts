/**
 * Puts pictures on the screen in order. For each view the newest pose wins: a picture is never followed by one of an
 * older pose, however the decodes finish. Every picture received is acknowledged once it was drawn or dropped (then with
 * the decode under way), since the server paces itself by the acknowledgements.
 */

import type { PictureHeader, ViewName } from "../wire/messages";
import type { WirePicture } from "../wire/parse";

export interface Decoded {
  close(): void;
}

export interface PictureSink<T extends Decoded> {
  decode(picture: WirePicture): Promise<T>;
  /** Called synchronously before the acknowledgement. The image is closed after it returns. */
  draw(header: PictureHeader, image: T, outline: WirePicture["outline"], layers: WirePicture["layers"]): void;
  acknowledge(frameId: number): void;
  /** A payload that is no image; the view keeps its last picture. */
  failed(header: PictureHeader): void;
}

interface ViewQueue {
  shown: PictureHeader | null;
  waiting: WirePicture | null;
  decoding: boolean;
  /** Dropped during the decode under way, and acknowledged with it: a client that is behind is not sent still more. */
  overtaken: number[];
}

/** The place on the screen that a picture is for: its own view, or the one that it stands in for. */
export const placeOf = (header: Pick<PictureHeader, "view" | "stands_for">): ViewName =>
  header.stands_for ?? header.view;

export function isOlder(a: Pick<PictureHeader, "pose_id" | "frame_id">, b: typeof a): boolean {
  return a.pose_id < b.pose_id || (a.pose_id === b.pose_id && a.frame_id < b.frame_id);
}

export class PictureBoard<T extends Decoded> {
  readonly #sink: PictureSink<T>;
  #views = new Map<ViewName, ViewQueue>();

  constructor(sink: PictureSink<T>) {
    this.#sink = sink;
  }

  /** A new connection or case counts its poses anew. Decodes still running belong to the old one and are not drawn. */
  reset(): void {
    this.#views = new Map();
  }

  receive(picture: WirePicture): void {
    const view = placeOf(picture.header);
    const queue = this.#views.get(view) ?? { shown: null, waiting: null, decoding: false, overtaken: [] };
    this.#views.set(view, queue);
    const rival = queue.waiting?.header ?? queue.shown;
    if (rival !== null && isOlder(picture.header, rival)) {
      this.#drop(queue, picture.header.frame_id);
      return;
    }
    if (queue.waiting !== null) this.#drop(queue, queue.waiting.header.frame_id);
    queue.waiting = picture;
    if (!queue.decoding) void this.#work(view, queue);
  }

  #drop(queue: ViewQueue, frameId: number): void {
    if (queue.decoding) queue.overtaken.push(frameId);
    else this.#sink.acknowledge(frameId);
  }

  async #work(view: ViewName, queue: ViewQueue): Promise<void> {
    queue.decoding = true;
    while (queue.waiting !== null) {
      const picture = queue.waiting;
      queue.waiting = null;
      await this.#show(view, queue, picture);
    }
    queue.decoding = false;
  }

  async #show(view: ViewName, queue: ViewQueue, picture: WirePicture): Promise<void> {
    const { header } = picture;
    try {
      const image = await this.#sink.decode(picture);
      // The view may have been reset while this picture was decoded.
      if (this.#views.get(view) === queue && (queue.shown === null || !isOlder(header, queue.shown))) {
        queue.shown = header;
        this.#sink.draw(header, image, picture.outline, picture.layers);
      }
      image.close();
    } catch {
      this.#sink.failed(header);
    } finally {
      this.#sink.acknowledge(header.frame_id);
      for (const frameId of queue.overtaken.splice(0)) this.#sink.acknowledge(frameId);
    }
  }
}
