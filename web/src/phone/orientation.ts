/** From what a phone says about how it is turned to the pen's orientation that Carina takes. */

export type Wxyz = readonly [number, number, number, number];

/** What of the browser's `DeviceOrientationEvent` is read; degrees. */
export interface Turned {
  readonly alpha: number | null;
  readonly beta: number | null;
  readonly gamma: number | null;
}

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
 * `device_from_pen`: the pen's right is the phone's right (+x), its forward the phone's upper edge (+y), its down away
 * from the person who looks at the screen (-z). A quarter turn about x takes down and forward there.
 */
const DEVICE_FROM_PEN: Wxyz = [Math.SQRT1_2, -Math.SQRT1_2, 0, 0];

/**
 * `earth_from_pen`, or null where the phone says nothing or nonsense.
 *
 * W3C Device Orientation: the device is turned by alpha about z, then beta about its x, then gamma about its y; earth is
 * x east, y north, z up. Whether the screen is shown upright or on its side changes nothing of that.
 */
export function penOrientation(turned: Turned): Wxyz | null {
  const { alpha, beta, gamma } = turned;
  if (alpha === null || beta === null || gamma === null) return null;
  if (![alpha, beta, gamma].every(Number.isFinite)) return null;
  return multiply(multiply(multiply(about(3, alpha), about(1, beta)), about(2, gamma)), DEVICE_FROM_PEN);
}
