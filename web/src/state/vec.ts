/** Small vectors and matrices. Points and directions are LPS (patient left, posterior, superior), lengths in mm. */

/** A point or vector, LPS. */
export type Vec3 = readonly [number, number, number];

/** Return a + b. */
export const add = (a: Vec3, b: Vec3): Vec3 => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
/** Return a - b. */
export const sub = (a: Vec3, b: Vec3): Vec3 => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
/** Return the vector a multiplied by the number s. */
export const scale = (a: Vec3, s: number): Vec3 => [a[0] * s, a[1] * s, a[2] * s];
/** Return the dot product of two vectors. */
export const dot = (a: Vec3, b: Vec3): number => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
/** Return the cross product a x b of two vectors. */
export const cross = (a: Vec3, b: Vec3): Vec3 => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];
/** Return the length of a vector. */
export const length = (a: Vec3): number => Math.hypot(a[0], a[1], a[2]);
/** Return the distance between two points. */
export const distance = (a: Vec3, b: Vec3): number => length(sub(a, b));
/** Return the linear interpolation between a (t = 0) and b (t = 1). */
export const lerp = (a: Vec3, b: Vec3, t: number): Vec3 => [
  a[0] + (b[0] - a[0]) * t,
  a[1] + (b[1] - a[1]) * t,
  a[2] + (b[2] - a[2]) * t,
];

/** Return the unit vector of a; a zero vector is returned unchanged. */
export function unit(a: Vec3): Vec3 {
  const n = length(a);
  return n > 0 ? scale(a, 1 / n) : a;
}

/** Convert a list of three numbers to a point; throw an Error for any other length. */
export function asVec3(values: readonly number[]): Vec3 {
  const [x, y, z] = values;
  if (values.length !== 3 || x === undefined || y === undefined || z === undefined) {
    throw new Error(`a point has three coordinates, found ${values.length}`);
  }
  return [x, y, z];
}

/** Return the first three numbers of column `index` (0..3) of a row-major 4x4 matrix. */
export function column(matrix: readonly number[], index: number): Vec3 {
  return [matrix[index] ?? 0, matrix[4 + index] ?? 0, matrix[8 + index] ?? 0];
}

/** Axes and position of a camera: +x right, +y down, +z forward. */
export interface Camera {
  right: Vec3;
  down: Vec3;
  forward: Vec3;
  position: Vec3;
}

/** Return a camera tilted upwards about its right axis by an angle in degrees, as in a forward-oblique scope. */
export function lookingUp(camera: Camera, deg: number): Camera {
  const c = Math.cos((deg * Math.PI) / 180);
  const s = Math.sin((deg * Math.PI) / 180);
  return {
    ...camera,
    forward: add(scale(camera.forward, c), scale(camera.down, -s)),
    down: add(scale(camera.down, c), scale(camera.forward, s)),
  };
}

/** Return the camera of a row-major matrix `lps_from_camera`. */
export function cameraFromMatrix(lpsFromCamera: readonly number[]): Camera {
  return {
    right: column(lpsFromCamera, 0),
    down: column(lpsFromCamera, 1),
    forward: column(lpsFromCamera, 2),
    position: column(lpsFromCamera, 3),
  };
}
