/** Ghost of the expert in the airway view: an outline of the expert's tip ahead, at the same place of the airways. */

import { pixelFromLps, type SeenGeometry } from "../state/projection";
import { add, cross, length, scale, sub, unit } from "../state/vec";
import { INK, type Ink, label } from "./ink";
import type { Scene } from "./scene";
import type { Viewport } from "./viewport";

/** Radius in mm of the drawn outline of the expert's tip: that of a usual bronchoscope. */
const TIP_MM = 2.5;

/** Draw the outline of the expert's tip; nothing if no ghost is shown or the tip is not in the picture. */
export function paintGhost(ink: Ink, viewport: Viewport, geometry: SeenGeometry, { ghost }: Scene): void {
  if (ghost === null) return;
  const seen = pixelFromLps(geometry, ghost);
  const side = cross(sub(ghost, geometry.camera.position), [0, 0, 1]);
  const across = length(side) < 1e-6 ? ([1, 0, 0] as const) : unit(side);
  const edge = pixelFromLps(geometry, add(ghost, scale([across[0], across[1], across[2]], TIP_MM)));
  if (seen === null || edge === null || seen.depthMm <= 0) return;
  const at = viewport.screenAt(seen);
  const rim = viewport.screenAt(edge);
  const radius = Math.max(Math.hypot(rim.x - at.x, rim.y - at.y), 5);
  ink.save();
  for (const [colour, width] of [
    [INK.halo, 5],
    [INK.lesion, 2.5],
  ] as const) {
    ink.strokeStyle = colour;
    ink.lineWidth = width;
    ink.beginPath();
    ink.arc(at.x, at.y, radius, 0, 2 * Math.PI);
    ink.stroke();
  }
  ink.restore();
  label(ink, "expert", { x: at.x, y: at.y + radius + 10 }, { size: 12, bold: false });
}
