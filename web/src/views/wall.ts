/**
 * All views on the screen: passes received pictures to the views, repaints the overlays, and reports the visible views
 * to the server.
 */

import type { PictureHeader, ViewName, ViewSize } from "../wire/messages";
import type { WireLayer } from "../wire/parse";
import { VIEWS } from "../wire/views";
import type { Shape } from "./outline";
import { paintAirway } from "./overlay-airway";
import { paintFlat } from "./overlay-flat";
import { paintLines } from "./overlay-lines";
import { paintSeen } from "./overlay-seen";
import { Painting } from "./painting";
import type { Scene } from "./scene";
import type { Viewport } from "./viewport";

/** Page functions that {@link Wall} uses; tests supply fakes. */
export interface WallHooks {
  scene(): Scene;
  layoutChanged(views: ViewSize[]): void;
  /** Return whether the window is visible; a window in the background requests no pictures. */
  isSeen(): boolean;
  /** Run a task at the next display refresh. */
  nextRefresh(task: () => void): void;
}

/** Collection of all views on the screen. */
export class Wall {
  readonly #viewports = new Set<Viewport>();
  readonly #hooks: WallHooks;
  readonly #painted = new WeakMap<Viewport, Painting>();
  #repaintDue = false;
  #layoutDue = false;
  #reported = "";

  constructor(hooks: WallHooks) {
    this.#hooks = hooks;
  }

  add(viewport: Viewport): () => void {
    this.#viewports.add(viewport);
    this.touchLayout();
    return () => {
      this.#viewports.delete(viewport);
      viewport.remove();
      this.touchLayout();
    };
  }

  find(view: ViewName): Viewport | null {
    for (const viewport of this.#viewports) if (viewport.view === view) return viewport;
    return null;
  }

  /** Return the view that has the keyboard focus; null if none has. */
  focused(): Viewport | null {
    for (const viewport of this.#viewports) if (viewport.hasFocus) return viewport;
    return null;
  }

  draw(
    header: PictureHeader,
    image: CanvasImageSource,
    outline: Uint8Array | null,
    layers: readonly WireLayer[] = [],
  ): boolean {
    const viewport = this.find(header.stands_for ?? header.view);
    if (viewport === null) return false;
    viewport.draw(header, image, outline, layers);
    // Paint now, so that the outline of one picture never appears over another picture.
    if (outline !== null || layers.length > 0) this.#paint(viewport, this.#hooks.scene());
    this.touch();
    return true;
  }

  show(viewport: Viewport, view: ViewName, shape: Shape): void {
    viewport.show(view, shape);
    this.touchLayout();
  }

  clear(): void {
    for (const viewport of this.#viewports) viewport.clear();
    this.touch();
  }

  /** Schedule a repaint of all overlays at the next display refresh, because the scene has changed. */
  touch(): void {
    if (this.#repaintDue) return;
    this.#repaintDue = true;
    this.#hooks.nextRefresh(() => {
      this.#repaintDue = false;
      const scene = this.#hooks.scene();
      for (const viewport of this.#viewports) this.#paint(viewport, scene);
    });
  }

  /**
   * Repaint the overlay of a view only if something that it shows has changed; most events, such as a cursor movement,
   * concern one view.
   */
  #paint(viewport: Viewport, scene: Scene): void {
    const seen = sceneIn(viewport, scene);
    if (this.#painted.get(viewport)?.holds(viewport, seen) === true) return;
    const painting = new Painting(viewport);
    if (paint(viewport, painting.watched(seen))) this.#painted.set(viewport, painting);
  }

  touchLayout(): void {
    this.touch();
    if (this.#layoutDue) return;
    this.#layoutDue = true;
    this.#hooks.nextRefresh(() => {
      this.#layoutDue = false;
      this.sendLayout(false);
    });
  }

  /**
   * Report the visible views and their sizes to the server if they have changed; with `again` also without a change,
   * for a new connection.
   */
  sendLayout(again: boolean): void {
    const views: ViewSize[] = [];
    for (const viewport of this.#hooks.isSeen() ? this.#viewports : []) {
      const pixels = viewport.wantedPixels;
      if (pixels !== null) views.push({ view: viewport.view, ...pixels });
    }
    const text = JSON.stringify(views);
    if (text === this.#reported && !again) return;
    this.#reported = text;
    this.#hooks.layoutChanged(views);
  }
}

/** Paint the overlay of a view; return false if there is no canvas. */
function paint(viewport: Viewport, scene: Scene): boolean {
  const ink = viewport.ink();
  if (ink === null) return false;
  // Select the overlay by the displayed picture, because a cut-plane may replace the airway view.
  PAINTERS[VIEWS[viewport.header?.view ?? viewport.view].overlay](ink, viewport, scene);
  return true;
}

/** Return the scene for one view: the cursor is included only for the view under the cursor. */
function sceneIn(viewport: Viewport, scene: Scene): Scene {
  return scene.cursor === null || scene.cursor.view === viewport.view ? scene : { ...scene, cursor: null };
}

const PAINTERS = { airway: paintAirway, seen: paintSeen, lines: paintLines, flat: paintFlat } as const;
