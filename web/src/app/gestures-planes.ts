/**
 * Movement of the planes in the tri-plane view: by a drag along a plane's normal, or by keys. A drag on the background
 * rotates the camera.
 */

import type { PictureGesture } from "../input/keymap";
import type { PointerPlace } from "../input/pointer";
import { geometryOf, type SeenGeometry } from "../state/projection";
import { dragMm, type PlaneHit, planeUnder } from "../state/tri-plane";
import { add, type Vec3 } from "../state/vec";
import { clampToVolume } from "../state/volume";
import type { Viewport } from "../views/viewport";
import type { Workstation } from "./workstation";

/** Movement of a plane by one key press, mm. */
const KEY_MM = 1;

/**
 * Return the axis of the plane that a key moves, and the direction of the movement: up and down move the axial plane,
 * left and right the sagittal plane, forward and back the coronal plane. Null for other keys.
 */
function movedBy(does: PictureGesture): { axis: 0 | 1 | 2; sign: number } | null {
  if (does.gesture === "scroll") return { axis: 2, sign: does.sign };
  if (does.gesture !== "pan") return null;
  return does.right === 0 ? { axis: 1, sign: -does.down } : { axis: 0, sign: does.right };
}

/** Handlers that move the planes of a tri-plane view. */
export interface PlaneDrag {
  /** Handle a movement of the pointer during a drag; return true if the drag moves a plane. */
  drag(at: PointerPlace, moved: { dx: number; dy: number }): boolean;
  release(): void;
  hover(at: PointerPlace | null): void;
  key(does: PictureGesture): boolean;
}

/** Return the handlers that move the planes of a tri-plane view. */
export function planeDrag(station: Workstation, viewport: Viewport): PlaneDrag {
  /**
   * The grabbed plane with the picture's geometry at the start of the drag; "orbit" if the drag began on the
   * background; null without a drag.
   */
  let held: { hit: PlaneHit; geometry: SeenGeometry; centre: Vec3 } | "orbit" | null = null;

  const seen = (): SeenGeometry | null => {
    const geometry = viewport.header === null ? null : geometryOf(viewport.header);
    return geometry?.kind === "seen" ? geometry : null;
  };
  const under = (at: PointerPlace): { hit: PlaneHit; geometry: SeenGeometry; centre: Vec3 } | null => {
    const geometry = seen();
    const grid = station.state.session?.case;
    const centre = station.centre();
    const pixel = viewport.pixelAt(at);
    if (geometry === null || grid == null || centre === null || pixel === null) return null;
    const hit = planeUnder(geometry, grid, centre, pixel);
    return hit === null ? null : { hit, geometry, centre };
  };
  const moveTo = (lps: Vec3): void => {
    const grid = station.state.session?.case;
    station.sendSoon({ type: "set_crosshair", lps: grid == null ? lps : clampToVolume(grid, lps) });
  };
  const moveBy = (from: Vec3, axis: 0 | 1 | 2, mm: number): Vec3 =>
    add(from, [axis === 0 ? mm : 0, axis === 1 ? mm : 0, axis === 2 ? mm : 0]);

  return {
    drag: (at, moved) => {
      // Find the plane under the start point of the drag, which is the current point minus the first movement.
      held ??= under({ x: at.x - moved.dx, y: at.y - moved.dy }) ?? "orbit";
      if (held === "orbit") return false;
      const perPx = viewport.magnification;
      const mm = dragMm(held.geometry, held.hit, { dx: moved.dx / perPx, dy: moved.dy / perPx });
      held = {
        ...held,
        centre: moveBy(held.centre, held.hit.axis, mm),
        hit: { ...held.hit, lps: moveBy(held.hit.lps, held.hit.axis, mm) },
      };
      moveTo(held.centre);
      return true;
    },
    release: () => {
      held = null;
    },
    hover: (at) => {
      const plane = at === null ? null : (under(at)?.hit.plane ?? null);
      // While a tool is active, the tool sets the shape of the cursor.
      viewport.host.style.cursor = plane === null || station.state.ui.armed !== null ? "" : "move";
      if (station.state.ui.overPlane !== plane) station.ui({ overPlane: plane });
    },
    key: (does) => {
      const move = movedBy(does);
      const centre = station.centre();
      if (move === null || centre === null) return false;
      moveTo(moveBy(centre, move.axis, move.sign * KEY_MM));
      return true;
    },
  };
}
