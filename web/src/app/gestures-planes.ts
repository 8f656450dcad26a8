/** Moving the planes of the tri-plane view: by a drag along their normal, or by keys. Elsewhere a drag orbits. */

import type { PictureGesture } from "../input/keymap";
import type { PointerPlace } from "../input/pointer";
import { geometryOf, type SeenGeometry } from "../state/projection";
import { dragMm, type PlaneHit, planeUnder } from "../state/tri-plane";
import { add, type Vec3 } from "../state/vec";
import { clampToVolume } from "../state/volume";
import type { Viewport } from "../views/viewport";
import type { Workstation } from "./workstation";

const KEY_MM = 1;

/** The plane that a key moves: the axial one up and down, the sagittal one left and right, the coronal one front and back. */
function movedBy(does: PictureGesture): { axis: 0 | 1 | 2; sign: number } | null {
  if (does.gesture === "scroll") return { axis: 2, sign: does.sign };
  if (does.gesture !== "pan") return null;
  return does.right === 0 ? { axis: 1, sign: -does.down } : { axis: 0, sign: does.right };
}

export interface PlaneDrag {
  /** True where a plane took the drag. */
  drag(at: PointerPlace, moved: { dx: number; dy: number }): boolean;
  release(): void;
  hover(at: PointerPlace | null): void;
  key(does: PictureGesture): boolean;
}

export function planeDrag(station: Workstation, viewport: Viewport): PlaneDrag {
  /** What the drag that runs has hold of; "orbit" where it began on the background. */
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
      // Where the drag began, not where its first step ended.
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
      // With a tool in the hand the cursor is the tool's.
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
