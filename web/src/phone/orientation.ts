/** Conversion of the phone's orientation angles to the pen orientation that the server expects. */

/** Unit quaternion (w, x, y, z). */
export type Wxyz = readonly [number, number, number, number];

/** The fields of the browser's `DeviceOrientationEvent` that Carina reads, in degrees. */
export interface Turned {
  readonly alpha: number | null;
  readonly beta: number | null;
  readonly gamma: number | null;
}

/** Return the quaternion product a b (rotation b first, then a). */
export function multiply(a: Wxyz, b: Wxyz): Wxyz {
  return [
    a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
    a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
    a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
    a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
  ];
}

const about = (axis: 1 | 2 | 3, deg: number): Wxyz => {
  const half = (deg * Math.PI) / 360;
  const turned: [number, number, number, number] = [Math.cos(half), 0, 0, 0];
  turned[axis] = Math.sin(half);
  return turned;
};

/**
 * Rotation `device_from_pen`: the pen's right is the phone's right (+x), the pen's forward is the phone's upper edge
 * (+y), and the pen's down points into the screen (-z). The rotation is a quarter turn about x.
 */
const DEVICE_FROM_PEN: Wxyz = [Math.SQRT1_2, -Math.SQRT1_2, 0, 0];

/**
 * Return the rotation `earth_from_pen` for the angles of a phone; null if an angle is missing or not finite.
 *
 * W3C Device Orientation: the device is rotated by alpha about z, then by beta about its x, then by gamma about its y.
 * The axes of the earth frame are x east, y north, z up. The angles do not depend on the orientation of the screen
 * (portrait or landscape).
 */
export function penOrientation(turned: Turned): Wxyz | null {
  const { alpha, beta, gamma } = turned;
  if (alpha === null || beta === null || gamma === null) return null;
  if (![alpha, beta, gamma].every(Number.isFinite)) return null;
  return multiply(multiply(multiply(about(3, alpha), about(1, beta)), about(2, gamma)), DEVICE_FROM_PEN);
}
