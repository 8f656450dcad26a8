/** Zoom, pan and reset of the slices and of the cut-plane. */

import type { PointerPlace } from "../input/pointer";
import { type FlatAxes, type FlatPlace, panned, zoomedAbout } from "../state/flat-place";
import { axesOf, type FlatGeometry, geometryOf, lpsFromPixel, mmPerPixel } from "../state/projection";
import type { Vec3 } from "../state/vec";
import { FLAT_VIEWS, isFlatView } from "../state/view-table";
import { clampToVolume } from "../state/volume";
import type { Viewport } from "../views/viewport";
import type { ViewName } from "../wire/messages";
import { VIEWS } from "../wire/views";
import { ZOOM_PER_PX } from "./gesture-parts";
import type { Workstation } from "./workstation";

const MM_PER_PX = { least: 0.02, most: 10 } as const;
/** Limits of the width that the cut-plane shows, mm; slightly narrower than the limits of the protocol. */
const EXTENT_MM = { least: 5, most: 500 } as const;
/** Distance of the pan by one press of an arrow key, CSS px. */
export const PAN_KEY_PX = 40;
/**
 * Time, ms, after a request, during which a gesture starts from the requested instead of the displayed position,
 * because gestures follow each other faster than pictures arrive.
 */
const MEMORY_MS = 400;

/** Handlers that change the centre and the scale of a planar view. */
export interface FlatPlacing {
  /** Zoom about the point under the cursor; a null `at` (zoom by key) zooms about the middle of the picture. */
  zoom(deltaPx: number, at: PointerPlace | null): void;
  /**
   * Pan by a movement of the hand. With `drags`, further movements start from the last requested position until {@link
   * release}, whatever pictures arrive.
   */
  pan(moved: { dx: number; dy: number }, drags?: boolean): void;
  /** End a drag, during which each pan starts from the last requested position. */
  release(): void;
}

/** Return the handlers that zoom and pan a planar view. */
export function flatPlacing(station: Workstation, viewport: Viewport): FlatPlacing {
  /**
   * The last requested position, with its time and the picture that was displayed at that time; null before the first
   * request.
   */
  let last: { view: ViewName; place: FlatPlace; atMs: number; header: Viewport["header"] } | null = null;
  let dragged = false;
  /**
   * Return whether the next gesture starts from the last requested position, because its picture may not have arrived;
   * a busy server may need a second for a picture.
   */
  const isAhead = (): boolean =>
    last !== null &&
    last.view === viewport.view &&
    (dragged || viewport.header === last.header || performance.now() - last.atMs < MEMORY_MS);

  const geometry = (): FlatGeometry | null => {
    const found = viewport.header === null ? null : geometryOf(viewport.header);
    return found?.kind === "flat" ? found : null;
  };
  /**
   * Return the position from which the next gesture starts, the picture's axes, and the scale of the picture; null if
   * the view has no planar picture.
   */
  const now = (): { place: FlatPlace; axes: FlatAxes; pxPerCss: number; wantedWidth: number } | null => {
    const { header, wantedPixels } = viewport;
    const flat = geometry();
    if (flat === null || header === null || wantedPixels === null) return null;
    const shown = {
      mmPerPx: (mmPerPixel(flat) * header.width) / wantedPixels.width,
      middle: lpsFromPixel(flat, { column: header.width / 2, row: header.height / 2 }),
    };
    return {
      place: isAhead() && last !== null ? last.place : shown,
      axes: axesOf(flat),
      pxPerCss: wantedPixels.width / header.width / viewport.magnification,
      wantedWidth: wantedPixels.width,
    };
  };
  const send = (place: FlatPlace, wantedWidth: number): void => {
    const { view } = viewport;
    if (!isFlatView(view)) return;
    const grid = station.state.session?.case;
    const middle = grid == null ? place.middle : clampToVolume(grid, place.middle);
    last = { view, place: { ...place, middle }, atMs: performance.now(), header: viewport.header };
    const byExtent = VIEWS[view].zoom === "extent";
    station.sendSoon({
      type: "set_zoom",
      view,
      mm_per_px: byExtent ? null : place.mmPerPx,
      extent_mm: byExtent ? place.mmPerPx * wantedWidth : null,
      centre_lps: middle,
    });
  };
  return {
    zoom: (deltaPx, at) => {
      const shown = now();
      const { header } = viewport;
      if (shown === null || header === null) return;
      const { place, axes, wantedWidth } = shown;
      const byExtent = VIEWS[viewport.view].zoom === "extent";
      const least = byExtent ? EXTENT_MM.least / wantedWidth : MM_PER_PX.least;
      const most = byExtent ? EXTENT_MM.most / wantedWidth : MM_PER_PX.most;
      const mmPerPx = Math.min(Math.max(place.mmPerPx * Math.exp(deltaPx * ZOOM_PER_PX), least), most);
      const pixel = at === null ? null : viewport.pixelAt(at);
      const perPx = wantedWidth / header.width;
      const about =
        pixel === null
          ? { right: 0, down: 0 }
          : { right: (pixel.column - header.width / 2) * perPx, down: (pixel.row - header.height / 2) * perPx };
      send(zoomedAbout(place, axes, mmPerPx, about), wantedWidth);
    },
    pan: ({ dx, dy }, drags = false) => {
      const shown = now();
      if (shown === null) return;
      dragged = drags;
      const px = { right: dx * shown.pxPerCss, down: dy * shown.pxPerCss };
      send(panned(shown.place, shown.axes, px), shown.wantedWidth);
    },
    release: () => {
      dragged = false;
    },
  };
}

/** Shorter side of the part of a slice that {@link showPlace} shows, mm: an airway with its surroundings. */
const PLACE_MM = 40;

/**
 * Move the airway view, the crosshair and all slices to a place of the airways, and zoom the slices in on the place.
 */
export function showPlace(station: Workstation, lps: Vec3, branchId: number | null): void {
  station.flight.stopAuto();
  station.pausePlaying();
  station.send({ type: "show_place", lps, branch_id: branchId });
  for (const view of FLAT_VIEWS) {
    const wanted = station.wall.find(view)?.wantedPixels ?? null;
    if (wanted === null) continue;
    const mmPerPx = PLACE_MM / Math.min(wanted.width, wanted.height);
    const byExtent = VIEWS[view].zoom === "extent";
    station.sendSoon({
      type: "set_zoom",
      view,
      mm_per_px: byExtent ? null : mmPerPx,
      extent_mm: byExtent ? mmPerPx * wanted.width : null,
      centre_lps: byExtent ? null : lps,
    });
  }
}

/** Reset a planar view: a slice shows its whole plane, the cut-plane its default width. */
export function fitPicture(station: Workstation, view: ViewName): void {
  if (isFlatView(view)) {
    station.sendSoon({ type: "set_zoom", view, mm_per_px: null, extent_mm: null, centre_lps: null });
  }
}
