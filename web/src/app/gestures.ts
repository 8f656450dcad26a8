/** Gestures of mouse, wheel and keys in a view, selected by the kind of the view. */

import { clickAction } from "../input/clicks";
import { bindingOf, placesOf } from "../input/keymap";
import { listenToPointer, type PointerPlace } from "../input/pointer";
import { WHEEL_MM_PER_PX } from "../input/steering";
import { type FlatGeometry, geometryOf, lpsFromPixel, mmPerPixel, normalOf } from "../state/projection";
import { add, asVec3, cameraFromMatrix, distance, dot, scale, sub, type Vec3 } from "../state/vec";
import { isOrbitView, type OrbitView } from "../state/view-table";
import { clampToVolume, middleOf } from "../state/volume";
import { isInside } from "../views/outline";
import type { Viewport } from "../views/viewport";
import type { Orbit } from "../wire/messages";
import { LEAD_VIEW, PLANES, type PlaneName, VIEWS } from "../wire/views";
import { dragWindow, type Gestures, ORBIT_DEG_PER_PX, ORBIT_KEY_DEG, ZOOM_KEY_PX, ZOOM_PER_PX } from "./gesture-parts";
import { carmGestures, pathGestures } from "./gestures-along";
import { fitPicture, flatPlacing, PAN_KEY_PX } from "./gestures-flat";
import { planeDrag } from "./gestures-planes";
import type { Workstation } from "./workstation";

/** Movement of the crosshair by one key press, mm. */
const CROSSHAIR_KEY_MM = 1;
/** Slices per px of scrolling: one wheel notch (100 px) scrolls one slice. */
const SCROLL_SLICES_PER_PX = 0.01;
/** Slices per px of a vertical drag by one finger: a drag over a hand's width scrolls through about 60 slices. */
const FINGER_SLICES_PER_PX = 0.2;

/**
 * Attach the gestures to a view, and return a function that detaches them. `doubleClick` enlarges the view or restores
 * its size.
 */
export function gesturesOf(station: Workstation, viewport: Viewport, doubleClick: () => void): () => void {
  const gestures = (): Gestures => {
    if (isOrbitView(viewport.view)) return orbitGestures(station, viewport, viewport.view);
    switch (VIEWS[viewport.view].zoom) {
      case "tip":
        return airwayGestures(station, viewport);
      case "slice":
      case "extent":
        return flatGestures(station, viewport);
      case "path":
        return pathGestures(station, viewport);
      case "carm":
        return carmGestures(station, viewport);
      case null:
        return { pointer: {} };
    }
  };
  // Keep the same gestures object while the view shows the same kind of picture, because it stores the start of a drag.
  let current = gestures();
  let view = viewport.view;
  const now = (): Gestures => {
    if (view !== viewport.view) {
      view = viewport.view;
      current = gestures();
    }
    return current;
  };
  const enter = () => {
    if (station.state.ui.armed === null) return doubleClick();
    // A key has no cursor position. It applies at the middle of the airway view, and at the crosshair in other views.
    const centre = station.centre();
    if (viewport.view === LEAD_VIEW) station.act("wall_point");
    else if (centre !== null) station.pointing.commitHere(centre);
  };
  const key = (event: KeyboardEvent) => {
    if (event.target !== viewport.host) return;
    const command = bindingOf(event, placesOf(viewport.view))?.command;
    if (command?.kind !== "picture") return;
    if (command.does.gesture === "enter") {
      // A held key repeats the event, but counts as one gesture.
      if (!event.repeat) enter();
    } else if (now().key?.(command.does) !== true) return;
    event.preventDefault();
  };
  viewport.host.addEventListener("keydown", key);
  /** Whether the first click of the current series applied a tool; the later clicks of such a series do nothing. */
  let forTool = false;
  const stopPointer = listenToPointer(viewport.host, {
    pans: () => now().pointer.pans?.() ?? false,
    click: (at, count) => {
      const armed = station.state.ui.armed !== null;
      forTool = armed || (forTool && count > 1);
      switch (clickAction(count, forTool)) {
        case "click":
          if (!armed) station.pointing.beginClick();
          if (!station.pointing.click(viewport, at)) now().pointer.click?.(at, count);
          break;
        case "enlarge":
          if (station.pointing.undoFirstClick()) doubleClick();
          break;
        case "nothing":
          break;
      }
    },
    secondaryClick: () => station.putToolAway(),
    drag: (at, moved, button, byFinger) => {
      station.pointing.dragged(viewport, at);
      now().pointer.drag?.(at, moved, button, byFinger);
    },
    release: () => now().pointer.release?.(),
    hover: (at, shift) => {
      now().pointer.hover?.(at, shift);
      station.pointing.hover(viewport, at);
    },
    wheel: (delta, zoom, at) => now().pointer.wheel?.(delta, zoom, at),
  });
  return () => {
    viewport.host.removeEventListener("keydown", key);
    stopPointer();
  };
}

function airwayGestures(station: Workstation, viewport: Viewport): Gestures {
  return {
    pointer: {
      click: (at) => {
        const { header, frame } = viewport;
        const pixel = viewport.pixelAt(at);
        if (header === null || pixel === null) return;
        const geometry = geometryOf(header);
        if (geometry?.kind === "flat") {
          // The viewfinder, which may replace the airway view, is a cut-plane. A click on it selects a point of that
          // plane.
          station.pick(lpsFromPixel(geometry, pixel));
          return;
        }
        if (!isInside(viewport.shape, frame, at)) return;
        station.pickWall(header, pixel);
      },
      drag: (_at, moved, button) => {
        if (button !== "main") return;
        const fovRad = (station.state.look.fov_deg * Math.PI) / 180;
        const side = Math.max(Math.min(viewport.frame.width, viewport.frame.height), 1);
        const perPx = fovRad / side;
        station.flight.nudge({ yaw_rad: moved.dx * perPx, pitch_rad: -moved.dy * perPx });
      },
      wheel: (delta) => station.flight.nudge({ advance_mm: -delta * WHEEL_MM_PER_PX }),
    },
  };
}

function flatGestures(station: Workstation, viewport: Viewport): Gestures {
  /**
   * Geometry and header of the picture at the start of the drag, because a zoom may move the picture under the pointer;
   * null without a drag.
   */
  let held: { geometry: FlatGeometry; viewport: Viewport["header"] } | null = null;
  const placing = flatPlacing(station, viewport);
  const flat = (): FlatGeometry | null => {
    if (viewport.header === null) return null;
    const geometry = geometryOf(viewport.header);
    return geometry?.kind === "flat" ? geometry : null;
  };
  const pointAt = (at: PointerPlace): Vec3 | null => {
    const geometry = held?.geometry ?? flat();
    const pixel = viewport.pixelAt(at);
    if (geometry === null || pixel === null || viewport.header === null) return null;
    // The current picture may have fewer pixels than the picture at the start of the drag, because the resolution is
    // reduced during movement. Scale its coordinates to the stored geometry.
    const of = held?.viewport ?? viewport.header;
    const factor = of.width / viewport.header.width;
    return lpsFromPixel(geometry, { column: pixel.column * factor, row: pixel.row * factor });
  };
  const moveCrosshair = (lps: Vec3): void => {
    const grid = station.state.session?.case;
    station.sendSoon({ type: "set_crosshair", lps: grid == null ? lps : clampToVolume(grid, lps) });
  };
  const scroll = (slices: number): void => {
    const geometry = flat();
    const centre = station.centre();
    if (geometry === null || centre === null) return;
    const { plane } = VIEWS[viewport.view];
    // A scroll down shows the next slice of the stack, in the order of radiology.
    const way = sliceStepMm(station, plane) * (plane === null ? 1 : PLANES[plane].next_slice);
    moveCrosshair(add(centre, scale(normalOf(geometry), slices * way)));
  };
  const moveBy = (right: number, down: number): void => {
    const geometry = flat();
    const centre = station.centre();
    if (geometry === null || centre === null) return;
    const perMm = 1 / mmPerPixel(geometry);
    const offset = add(scale(geometry.perColumn, right * perMm), scale(geometry.perRow, down * perMm));
    moveCrosshair(add(centre, offset));
  };
  let scrolled = 0;
  /** Scroll by a number of slices, whose fraction is saved for the next call. */
  const scrollBy = (slices: number): void => {
    scrolled += slices;
    const whole = Math.trunc(scrolled);
    scrolled -= whole;
    if (whole !== 0) scroll(whole);
  };
  return {
    pointer: {
      pans: () => true,
      click: (at) => {
        const lps = pointAt(at);
        if (lps !== null) station.pick(lps);
      },
      drag: (at, moved, button, byFinger) => {
        if (button === "window") {
          dragWindow(station, moved);
          return;
        }
        if (byFinger && station.state.ui.armed === null && VIEWS[viewport.view].zoom === "slice") {
          // A finger has no wheel: a vertical drag scrolls, a tap moves the crosshair, two fingers pan and zoom.
          scrollBy(moved.dy * FINGER_SLICES_PER_PX);
          return;
        }
        if (button === "pan") {
          placing.pan(moved, true);
          return;
        }
        if (station.pointing.stroke(viewport, at)) return;
        const geometry = flat();
        if (held === null && geometry !== null) held = { geometry, viewport: viewport.header };
        const lps = pointAt(at);
        if (lps !== null) moveCrosshair(lps);
      },
      release: () => {
        held = null;
        placing.release();
        station.pointing.endStroke();
      },
      hover: (at, shift) => {
        const lps = at === null ? null : pointAt(at);
        station.ui({ cursorLps: lps });
        if (lps !== null) station.sendSoon({ type: "probe", lps });
        if (shift && lps !== null) moveCrosshair(lps);
      },
      wheel: (delta, isZoom, at) => {
        if (isZoom || VIEWS[viewport.view].zoom !== "slice") {
          placing.zoom(delta, at);
          return;
        }
        scrollBy(delta * SCROLL_SLICES_PER_PX);
      },
    },
    key: (does) => {
      if (does.gesture === "scroll") scroll(-does.sign);
      // An arrow key moves the visible region, so the picture moves in the opposite direction.
      else if (does.gesture === "pan") placing.pan({ dx: -does.right * PAN_KEY_PX, dy: -does.down * PAN_KEY_PX });
      else if (does.gesture === "zoom") placing.zoom(-does.sign * ZOOM_KEY_PX, null);
      else if (does.gesture === "fit") fitPicture(station, viewport.view);
      else if (does.gesture === "move") moveBy(does.right * CROSSHAIR_KEY_MM, does.down * CROSSHAIR_KEY_MM);
      else return false;
      return true;
    },
  };
}

/** Return the distance, mm, between the slices of a plane: the voxel spacing across the plane. */
function sliceStepMm(station: Workstation, plane: PlaneName | null): number {
  const spacing = station.state.session?.case?.spacing_mm;
  return Math.max(spacing?.[plane === null ? 0 : PLANES[plane].axis] ?? 1, 0.2);
}

function orbitGestures(station: Workstation, viewport: Viewport, view: OrbitView): Gestures {
  const planes = VIEWS[view].pick === "planes" ? planeDrag(station, viewport) : null;
  const orbit = (): Orbit => station.state.sight.orbits[view] ?? VIEWS[view].orbit;
  const change = (next: Orbit) =>
    station.sendSoon({
      type: "set_orbit",
      view,
      ...next,
      azimuth_deg: ((((next.azimuth_deg + 180) % 360) + 360) % 360) - 180,
      elevation_deg: Math.min(Math.max(next.elevation_deg, -89), 89),
    });
  const turn = (azimuth: number, elevation: number) => {
    const now = orbit();
    change({ ...now, azimuth_deg: now.azimuth_deg + azimuth, elevation_deg: now.elevation_deg + elevation });
  };
  const zoom = (deltaPx: number) => {
    const now = orbit();
    const from = now.distance_mm ?? seenDistanceMm(station, viewport, view);
    if (from === null) return;
    change({ ...now, distance_mm: Math.min(Math.max(from * Math.exp(deltaPx * ZOOM_PER_PX), 5), 4000) });
  };
  return {
    pointer: {
      drag: (at, moved, button) => {
        if (button === "main") {
          if (planes?.drag(at, moved) === true) return;
          turn(-moved.dx * ORBIT_DEG_PER_PX, moved.dy * ORBIT_DEG_PER_PX);
        } else if (VIEWS[view].windowed) dragWindow(station, moved);
      },
      release: () => planes?.release(),
      hover: (at) => planes?.hover(at),
      wheel: (delta) => zoom(delta),
    },
    key: (does) => {
      if (does.gesture === "zoom") zoom(-does.sign * ZOOM_KEY_PX);
      else if (does.gesture === "fit") change({ azimuth_deg: 0, elevation_deg: 0, distance_mm: null });
      else if (does.gesture === "move") turn(-does.right * ORBIT_KEY_DEG, does.down * ORBIT_KEY_DEG);
      else return planes?.key(does) === true;
      return true;
    },
  };
}

/**
 * Return the distance, mm, between the camera of an outside view and the point that it looks at, computed from the
 * displayed picture. Needed while the server selects the distance. Null without a picture or tree.
 */
function seenDistanceMm(station: Workstation, viewport: Viewport, view: OrbitView): number | null {
  const matrix = viewport.header?.lps_from_camera ?? null;
  if (matrix === null) return null;
  const camera = cameraFromMatrix(matrix);
  if (VIEWS[view].pick === "planes") {
    const info = station.state.session?.case;
    return info == null ? null : distance(middleOf(info), camera.position);
  }
  let low: Vec3 | null = null;
  let high: Vec3 | null = null;
  for (const node of station.state.tree?.byId.values() ?? []) {
    for (const point of node.branch.points) {
      const p = asVec3(point);
      low = low === null ? p : [Math.min(low[0], p[0]), Math.min(low[1], p[1]), Math.min(low[2], p[2])];
      high = high === null ? p : [Math.max(high[0], p[0]), Math.max(high[1], p[1]), Math.max(high[2], p[2])];
    }
  }
  if (low === null || high === null) return null;
  return Math.abs(dot(sub(scale(add(low, high), 0.5), camera.position), camera.forward));
}
