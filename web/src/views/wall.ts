/** All pictures on the screen: hands each its frames, repaints what is drawn over them, tells the server what is visible. */

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

export interface WallHooks {
  scene(): Scene;
  layoutChanged(views: ViewSize[]): void;
  /** Whether anybody sees the pictures: those of a window in the background are not asked for. */
  isSeen(): boolean;
  /** Runs a task at the next screen refresh. */
  nextRefresh(task: () => void): void;
}

export class Wall {
  readonly #viewports = new Set<Viewport>();
  readonly #hooks: WallHooks;
  readonly #painted = new WeakMap<Viewport, Painting>();
  #repaintDue = false;
  #layoutDue = false;
  #told = "";

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

  draw(
    header: PictureHeader,
    image: CanvasImageSource,
    outline: Uint8Array | null,
    layers: readonly WireLayer[] = [],
  ): boolean {
    const viewport = this.find(header.stands_for ?? header.view);
    if (viewport === null) return false;
    viewport.draw(header, image, outline, layers);
    // At once: the outline of one picture is never seen over another.
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

  /** Something that is drawn over the pictures has changed. */
  touch(): void {
    if (this.#repaintDue) return;
    this.#repaintDue = true;
    this.#hooks.nextRefresh(() => {
      this.#repaintDue = false;
      const scene = this.#hooks.scene();
      for (const viewport of this.#viewports) this.#paint(viewport, scene);
    });
  }

  /** Only what has changed: most of what happens, such as the cursor's moves, concerns one picture. */
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
      this.tellLayout(false);
    });
  }

  /** Tells the server what is visible; `again` also where nothing changed, for a new connection. */
  tellLayout(again: boolean): void {
    const views: ViewSize[] = [];
    for (const viewport of this.#hooks.isSeen() ? this.#viewports : []) {
      const pixels = viewport.wantedPixels;
      if (pixels !== null) views.push({ view: viewport.view, ...pixels });
    }
    const text = JSON.stringify(views);
    if (text === this.#told && !again) return;
    this.#told = text;
    this.#hooks.layoutChanged(views);
  }
}

/** Whether there was anything to paint on. */
function paint(viewport: Viewport, scene: Scene): boolean {
  const ink = viewport.ink();
  if (ink === null) return false;
  // What the picture shows decides, not the place that it is in: the view finder is a cut-plane in the airway's place.
  PAINTERS[VIEWS[viewport.header?.view ?? viewport.view].overlay](ink, viewport, scene);
  return true;
}

/** The cursor is in one picture, and concerns no other. */
function sceneIn(viewport: Viewport, scene: Scene): Scene {
  return scene.cursor === null || scene.cursor.view === viewport.view ? scene : { ...scene, cursor: null };
}

const PAINTERS = { airway: paintAirway, seen: paintSeen, lines: paintLines, flat: paintFlat } as const;
