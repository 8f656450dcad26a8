/** Gestures of mouse, wheel and keys in the pictures along the route and in the radiograph. */

import type { PointerPlace } from "../input/pointer";
import { linesOf, lpsAt, pathMmAt } from "../state/lines";
import { geometryOf } from "../state/projection";
import { distance, type Vec3 } from "../state/vec";
import { middleOf } from "../state/volume";
import type { Viewport } from "../views/viewport";
import { type Carm, FIRST_SIGHT, type Reformation } from "../wire/messages";
import { dragWindow, type Gestures, ORBIT_DEG_PER_PX, ORBIT_KEY_DEG, ZOOM_KEY_PX, ZOOM_PER_PX } from "./gesture-parts";
import type { Workstation } from "./workstation";

/** Movement along the route by one press of an arrow key, mm. */
const STEP_MM = 2;
const MM_PER_PX = { least: 0.02, most: 10 } as const;

const clampScale = (mmPerPx: number): number => Math.min(Math.max(mmPerPx, MM_PER_PX.least), MM_PER_PX.most);
const halfTurn = (deg: number): number => ((((deg + 180) % 360) + 360) % 360) - 180;

/** Return the gestures of a curved or straightened picture along the route. */
export function pathGestures(station: Workstation, viewport: Viewport): Gestures {
  const shown = (): Reformation => station.state.sight.reformation;
  const change = (next: Reformation) => station.sendSoon({ type: "set_reformation", ...next });
  const turn = (deg: number) => change({ ...shown(), turn_deg: halfTurn(shown().turn_deg + deg) });
  const lines = () => linesOf(viewport.header?.lines ?? null);
  const pointAt = (at: PointerPlace): Vec3 | null => {
    const geometry = lines();
    const pixel = viewport.pixelAt(at);
    return geometry === null || pixel === null ? null : lpsAt(geometry, pixel);
  };
  const zoom = (deltaPx: number) => {
    const geometry = lines();
    const { header, wantedPixels } = viewport;
    if (geometry === null || header === null || wantedPixels === null) return;
    const scaleNow = shown().mm_per_px ?? (geometry.mmPerPx * header.width) / wantedPixels.width;
    change({ ...shown(), mm_per_px: clampScale(scaleNow * Math.exp(deltaPx * ZOOM_PER_PX)) });
  };
  return {
    pointer: {
      click: (at) => {
        const geometry = lines();
        const pixel = viewport.pixelAt(at);
        if (geometry === null || pixel === null) return;
        const there = pathMmAt(geometry, pixel.row);
        station.pointing.unlessDouble(() => station.goTo(there));
      },
      drag: (_at, moved, button) => {
        if (button === "main") turn(moved.dx * ORBIT_DEG_PER_PX);
        else dragWindow(station, moved);
      },
      hover: (at) => {
        const lps = at === null ? null : pointAt(at);
        station.ui({ cursorLps: lps });
        if (lps !== null) station.sendSoon({ type: "probe", lps });
      },
      wheel: (delta) => zoom(delta),
    },
    key: (does) => {
      if (does.gesture === "zoom") zoom(-does.sign * ZOOM_KEY_PX);
      else if (does.gesture === "fit") change(FIRST_SIGHT.reformation);
      else if (does.gesture === "move" && does.right !== 0) turn(does.right * ORBIT_KEY_DEG);
      else if (does.gesture === "move") {
        const here = station.pathMm();
        if (here !== null) station.goTo(here + does.down * STEP_MM);
      } else return false;
      return true;
    },
  };
}

/** Return the gestures of the radiograph. */
export function carmGestures(station: Workstation, viewport: Viewport): Gestures {
  const shown = (): Carm => station.state.sight.carm;
  const change = (next: Carm) => station.sendSoon({ type: "set_carm", ...next });
  const turn = (primary: number, secondary: number) => {
    const now = shown();
    change({
      ...now,
      primary_deg: halfTurn(now.primary_deg + primary),
      secondary_deg: Math.min(Math.max(now.secondary_deg + secondary, -90), 90),
    });
  };
  const zoom = (deltaPx: number) => {
    const { header, wantedPixels } = viewport;
    const info = station.state.session?.case;
    if (header === null || wantedPixels === null || info == null) return;
    const geometry = geometryOf(header);
    if (geometry === null || geometry.kind !== "seen") return;
    // The C-arm rotates about the middle of the volume, so the scale (mm per px) is that at the distance of the middle.
    const mmPerPx = distance(geometry.camera.position, middleOf(info)) / geometry.focalPx;
    const scaleNow = shown().mm_per_px ?? (mmPerPx * header.width) / wantedPixels.width;
    change({ ...shown(), mm_per_px: clampScale(scaleNow * Math.exp(deltaPx * ZOOM_PER_PX)) });
  };
  return {
    pointer: {
      // The detector moves against the drag, so that the patient appears to turn with the hand.
      drag: (_at, moved, button) => {
        if (button === "main") turn(-moved.dx * ORBIT_DEG_PER_PX, moved.dy * ORBIT_DEG_PER_PX);
      },
      wheel: (delta) => zoom(delta),
    },
    key: (does) => {
      if (does.gesture === "zoom") zoom(-does.sign * ZOOM_KEY_PX);
      else if (does.gesture === "fit") change({ ...FIRST_SIGHT.carm, tone: shown().tone });
      else if (does.gesture === "move") turn(-does.right * ORBIT_KEY_DEG, does.down * ORBIT_KEY_DEG);
      else return false;
      return true;
    },
  };
}
