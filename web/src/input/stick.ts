/** Deflection of a stick of the flight pad by the place of a thumb. */

/** Radius of a stick's dead zone, in which a thumb causes no movement, as a share of the stick's radius. */
const DEAD = 0.12;

/** Return the deflection of a stick, -1 to 1 on each axis with `down` downwards, for a thumb in a square of a size. */
export function deflectionOf(x: number, y: number, size: number): { right: number; down: number } {
  const radius = size / 2;
  const right = (x - radius) / radius;
  const down = (y - radius) / radius;
  const length = Math.hypot(right, down);
  if (!(length > DEAD)) return { right: 0, down: 0 };
  // The deflection grows with the square of the distance, so that small movements are slow and exact.
  const strength = ((Math.min(length, 1) - DEAD) / (1 - DEAD)) ** 2;
  return { right: (right / length) * strength, down: (down / length) * strength };
}
