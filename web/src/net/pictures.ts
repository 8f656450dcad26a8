/**
 * Display of received pictures in order.
 *
 * In each view a picture of an older pose never replaces a picture of a newer pose, in whatever order the decoders
 * finish. The client acknowledges each picture after the picture was drawn or dropped, because the server adapts its
 * rate to the acknowledgements. A picture that is dropped during a decode is acknowledged when that decode ends.
 */

import type { PictureHeader, ViewName } from "../wire/messages";
import type { WirePicture } from "../wire/parse";

/** A decoded image that can be released. */
export interface Decoded {
  close(): void;
}

/** Decoder and drawing target of a picture. */
export interface PictureSink<T extends Decoded> {
  decode(picture: WirePicture): Promise<T>;
  /** Draw a picture. The caller closes the image after this method returns, then acknowledges the picture. */
  draw(header: PictureHeader, image: T, outline: WirePicture["outline"], layers: WirePicture["layers"]): void;
  acknowledge(frameId: number): void;
  /** Report a payload that is not an image; the view still shows its previous picture. */
  failed(header: PictureHeader): void;
}

interface ViewQueue {
  shown: PictureHeader | null;
  waiting: WirePicture | null;
  decoding: boolean;
  /**
   * IDs of the frames that were dropped during the current decode. They are acknowledged when the decode ends, so that
   * the server sends fewer pictures to a slow client.
   */
  overtaken: number[];
}

/**
 * Return the view in whose place the picture is displayed: the picture's view, or the view that the picture replaces.
 */
export const placeOf = (header: Pick<PictureHeader, "view" | "stands_for">): ViewName =>
  header.stands_for ?? header.view;

/** Return whether picture `a` is of an older pose, or an older frame of the same pose, than picture `b`. */
export function isOlder(a: Pick<PictureHeader, "pose_id" | "frame_id">, b: typeof a): boolean {
  return a.pose_id < b.pose_id || (a.pose_id === b.pose_id && a.frame_id < b.frame_id);
}

/** Queues of received pictures, one per view, which draw the latest picture of each view. */
export class PictureBoard<T extends Decoded> {
  readonly #sink: PictureSink<T>;
  #views = new Map<ViewName, ViewQueue>();

  constructor(sink: PictureSink<T>) {
    this.#sink = sink;
  }

  /**
   * Clear all queues for a new connection or case, in which pose numbers start again. Pictures that are being decoded
   * are not drawn.
   */
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
      // Draw the picture only if its queue was not reset during the decode, and no newer picture was drawn.
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
