/**
 * One view on the screen: a canvas for the picture, a canvas for the overlay, and the conversion between the
 * coordinates of both.
 */

import type { PixelPoint } from "../state/projection";
import type { PictureHeader, ViewName } from "../wire/messages";
import type { WireLayer } from "../wire/parse";
import { VIEWS } from "../wire/views";
import type { Ink, Rect, ScreenPoint } from "./ink";
import { type DrawnLayer, drawnLayers } from "./layer-path";
import { clipPathOf, type Shape } from "./outline";
import { outlinePath } from "./outline-path";

/** Minimum picture side that the protocol accepts, px. */
const MIN_SIDE_PX = 16;
/** Space for the letters on each side of a round picture, CSS px. */
export const RING_PX = 26;

/** Elements over a picture that cover what the overlay draws below them. */
const OVER_PICTURE = ".tool-tag, .reading, .finder-label, .empty";

/** One view on the screen. */
export class Viewport {
  readonly host: HTMLElement;
  readonly picture: HTMLCanvasElement;
  readonly overlay: HTMLCanvasElement;
  header: PictureHeader | null = null;
  /** Outline of the lumen, in pixels of the displayed picture; null without one. */
  outline: Path2D | null = null;
  /** Layers of the displayed picture. */
  layers: readonly DrawnLayer[] = [];
  /** Number that changes with the displayed picture, its size or its shape, but not with the overlay. */
  version = 0;
  #view: ViewName;
  #shape: Shape;
  #hostSize = { width: 0, height: 0 };
  #ratio = 1;

  constructor(host: HTMLElement, view: ViewName, shape: Shape) {
    this.host = host;
    this.#view = view;
    this.#shape = shape;
    this.picture = document.createElement("canvas");
    this.picture.className = "picture";
    this.overlay = document.createElement("canvas");
    this.overlay.className = "overlay";
    this.overlay.setAttribute("aria-hidden", "true");
    // The browser may discard the contents of a canvas in the background; paint them again when the browser restores
    // the canvas.
    this.overlay.addEventListener("contextrestored", () => {
      this.version += 1;
    });
    host.append(this.picture, this.overlay);
    this.#describe();
  }

  /** Whether the host element has the keyboard focus. */
  get hasFocus(): boolean {
    return this.host.contains(document.activeElement);
  }

  get view(): ViewName {
    return this.#view;
  }

  get shape(): Shape {
    return this.#shape;
  }

  /**
   * Show another view in the same place. The old picture is cleared, so that it is not mistaken for a picture of the
   * new view.
   */
  show(view: ViewName, shape: Shape): void {
    const changed = view !== this.#view;
    this.#view = view;
    this.#shape = shape;
    this.version += 1;
    if (changed) this.clear();
    this.#place();
  }

  clear(): void {
    this.version += 1;
    this.header = null;
    this.outline = null;
    this.layers = [];
    this.picture.getContext("2d")?.clearRect(0, 0, this.picture.width, this.picture.height);
    this.#describe();
  }

  resize(width: number, height: number, ratio: number): void {
    this.#hostSize = { width, height };
    this.#ratio = ratio;
    this.version += 1;
    this.overlay.width = Math.max(Math.round(width * ratio), 1);
    this.overlay.height = Math.max(Math.round(height * ratio), 1);
    this.#place();
  }

  /** Rectangle of the picture in the host element, CSS px. */
  get frame(): Rect {
    const { width, height } = this.#hostSize;
    if (this.#shape === "fill") return { x: 0, y: 0, width, height };
    const side = Math.max(Math.min(width, height) - 2 * RING_PX, 0);
    return { x: (width - side) / 2, y: (height - side) / 2, width: side, height: side };
  }

  get middle(): ScreenPoint {
    const { x, y, width, height } = this.frame;
    return { x: x + width / 2, y: y + height / 2 };
  }

  get size(): { width: number; height: number } {
    return this.#hostSize;
  }

  /** Picture size to request from the server, device pixels; null if the host element has no space for a picture. */
  get wantedPixels(): { width: number; height: number } | null {
    const { width, height } = this.frame;
    const scale = Math.min(this.#ratio, VIEWS[this.#view].max_px / Math.max(width, height, 1));
    const pixels = { width: Math.round(width * scale), height: Math.round(height * scale) };
    return Math.min(pixels.width, pixels.height) < MIN_SIDE_PX ? null : pixels;
  }

  /** Picture size on the screen for a saved picture, device pixels; null if the host element has no space for one. */
  get screenPixels(): { width: number; height: number; fullWidth: number } | null {
    const wanted = this.wantedPixels;
    if (wanted === null) return null;
    const { width, height } = this.frame;
    return {
      width: Math.round(width * this.#ratio),
      height: Math.round(height * this.#ratio),
      fullWidth: wanted.width,
    };
  }

  draw(
    header: PictureHeader,
    image: CanvasImageSource,
    outline: Uint8Array | null,
    layers: readonly WireLayer[] = [],
  ): void {
    const ink = this.picture.getContext("2d");
    if (ink === null) return;
    this.header = header;
    this.version += 1;
    this.outline = outline === null ? null : outlinePath(outline);
    this.layers = drawnLayers(layers);
    const { width, height } = this.picture;
    const fit = fitInside(header, width, height);
    // While the view changes its size, a picture with other proportions may arrive. Clear the uncovered part of the
    // canvas, which would show an older picture.
    if (fit.width < width || fit.height < height) ink.clearRect(0, 0, width, height);
    ink.imageSmoothingEnabled = true;
    ink.imageSmoothingQuality = "high";
    ink.drawImage(image, fit.x, fit.y, fit.width, fit.height);
    this.#describe();
  }

  /** Convert a position in the host element (CSS px) to picture coordinates; null without a picture. */
  pixelAt(at: ScreenPoint): PixelPoint | null {
    if (this.header === null) return null;
    const place = this.#pictureOnHost(this.header);
    return {
      column: ((at.x - place.x) / place.width) * this.header.width,
      row: ((at.y - place.y) / place.height) * this.header.height,
    };
  }

  screenAt(pixel: PixelPoint): ScreenPoint {
    if (this.header === null) return { x: 0, y: 0 };
    const place = this.#pictureOnHost(this.header);
    return {
      x: place.x + (pixel.column / this.header.width) * place.width,
      y: place.y + (pixel.row / this.header.height) * place.height,
    };
  }

  /** Size of a pixel of the picture on the screen, CSS px. */
  get magnification(): number {
    return this.header === null ? 1 : this.#pictureOnHost(this.header).width / this.header.width;
  }

  /** Clear the overlay canvas and return its context, with coordinates in CSS px; null if the browser provides none. */
  ink(): Ink | null {
    const ink = this.overlay.getContext("2d");
    if (ink === null) return null;
    ink.setTransform(1, 0, 0, 1, 0, 0);
    ink.clearRect(0, 0, this.overlay.width, this.overlay.height);
    ink.setTransform(this.#ratio, 0, 0, this.#ratio, 0, 0);
    return ink;
  }

  /** Return the parts of the host element that other elements cover, CSS px. */
  coveredParts(): readonly Rect[] {
    const host = this.host.getBoundingClientRect();
    const over = this.host.parentElement?.querySelectorAll(OVER_PICTURE) ?? [];
    return [...over]
      .map((element) => element.getBoundingClientRect())
      .filter(({ width, height }) => width > 0 && height > 0)
      .map(({ x, y, width, height }) => ({ x: x - host.x, y: y - host.y, width, height }));
  }

  remove(): void {
    this.picture.remove();
    this.overlay.remove();
  }

  #pictureOnHost(header: PictureHeader): Rect {
    const frame = this.frame;
    const fit = fitInside(header, frame.width, frame.height);
    return { ...fit, x: frame.x + fit.x, y: frame.y + fit.y };
  }

  #place(): void {
    const frame = this.frame;
    // Keep the picture of a view without size, which is hidden behind an enlarged view, until the view is visible
    // again.
    if (frame.width < 1 || frame.height < 1) return;
    const { style } = this.picture;
    style.left = `${frame.x}px`;
    style.top = `${frame.y}px`;
    style.width = `${frame.width}px`;
    style.height = `${frame.height}px`;
    style.clipPath = clipPathOf(this.#shape);
    const width = Math.max(Math.round(frame.width * this.#ratio), 1);
    const height = Math.max(Math.round(frame.height * this.#ratio), 1);
    if (this.picture.width === width && this.picture.height === height) return;
    // A change of a canvas's size clears the canvas. Copy the last picture and scale it, until the next picture
    // arrives.
    const copy = this.header === null ? null : copyOf(this.picture);
    this.picture.width = width;
    this.picture.height = height;
    if (copy !== null && this.header !== null) {
      // Use the proportions of the picture, as the overlay does, not those of the old canvas.
      const from = fitInside(this.header, copy.width, copy.height);
      const to = fitInside(this.header, width, height);
      this.picture
        .getContext("2d")
        ?.drawImage(copy, from.x, from.y, from.width, from.height, to.x, to.y, to.width, to.height);
    }
  }

  /** Write the state of the displayed picture to data attributes, for browser tests. */
  #describe(): void {
    const { dataset } = this.picture;
    dataset.view = this.#view;
    this.overlay.dataset.overlay = this.#view;
    dataset.frameId = this.header === null ? "" : String(this.header.frame_id);
    dataset.poseId = this.header === null ? "" : String(this.header.pose_id);
    dataset.full = this.header === null ? "" : String(this.header.full);
    // Name of the picture that replaces the view's picture; empty if none does.
    dataset.shows = this.header === null || this.header.stands_for === null ? "" : this.header.view;
  }
}

function fitInside(of: { width: number; height: number }, width: number, height: number): Rect {
  const scale = Math.min(width / of.width, height / of.height);
  // Treat proportions within a rounding error as equal, so that no thin line remains at the edge.
  const near = Math.abs(width / of.width - height / of.height) < 0.02 * scale;
  const fitted = near ? { width, height } : { width: of.width * scale, height: of.height * scale };
  return { x: (width - fitted.width) / 2, y: (height - fitted.height) / 2, ...fitted };
}

function copyOf(canvas: HTMLCanvasElement): HTMLCanvasElement {
  const copy = document.createElement("canvas");
  copy.width = canvas.width;
  copy.height = canvas.height;
  copy.getContext("2d")?.drawImage(canvas, 0, 0);
  return copy;
}
