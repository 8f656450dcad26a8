/**
 * Projection between pixels and patient space, for planar pictures (slices, cut-plane, X-ray) and camera pictures
 * (airway, tree).
 */

import type { PictureLens } from "../wire/messages";
import { add, type Camera, cameraFromMatrix, column, cross, dot, scale, sub, unit, type Vec3 } from "./vec";

/** Position in a picture, px. The corner of the top-left pixel is (0, 0); the centre of that pixel is (0.5, 0.5). */
export interface PixelPoint {
  column: number;
  row: number;
}

/** Position in a picture with its depth. */
export interface SeenPoint extends PixelPoint {
  /**
   * Depth along the viewing direction, mm: behind the plane (planar picture) or in front of the camera (camera
   * picture).
   */
  depthMm: number;
}

/** Geometry of a planar picture. */
export interface FlatGeometry {
  kind: "flat";
  origin: Vec3;
  /** Patient vectors (LPS, mm) of one pixel to the right, `perColumn`, and of one pixel down, `perRow`. */
  perColumn: Vec3;
  perRow: Vec3;
}

/** Geometry of a camera picture. */
export interface SeenGeometry {
  kind: "seen";
  camera: Camera;
  focalPx: number;
  /** The lens model of the camera; null for a pinhole camera. */
  lens: PictureLens | null;
  width: number;
  height: number;
}

/** Geometry of a planar picture or of a camera picture. */
export type Geometry = FlatGeometry | SeenGeometry;

/** Properties of a picture header that define the picture's position and scale in the patient. */
export interface Placed {
  width: number;
  height: number;
  lps_from_pixel: readonly number[] | null;
  lps_from_camera: readonly number[] | null;
  fov_deg: number | null;
  lens: PictureLens | null;
  /** Whether the picture shows a simulated breathing; `lps_from_camera` is then affine and not rigid. */
  breathes?: boolean;
}

/**
 * Return the geometry of a picture; null if its header has none. A cut-plane also has a camera, but counts as planar.
 */
export function geometryOf(picture: Placed): Geometry | null {
  if (picture.lps_from_pixel !== null) {
    return {
      kind: "flat",
      perColumn: column(picture.lps_from_pixel, 0),
      perRow: column(picture.lps_from_pixel, 1),
      origin: column(picture.lps_from_pixel, 3),
    };
  }
  if (picture.lps_from_camera !== null && picture.fov_deg !== null && picture.fov_deg < 179) {
    // The field of view is the full angle across the image circle, whose diameter is the shorter side of the picture.
    const focalPx = (0.5 * Math.min(picture.width, picture.height)) / Math.tan((picture.fov_deg * Math.PI) / 360);
    return {
      kind: "seen",
      camera: picture.breathes ? dualCamera(picture.lps_from_camera) : cameraFromMatrix(picture.lps_from_camera),
      focalPx,
      lens: picture.lens,
      width: picture.width,
      height: picture.height,
    };
  }
  return null;
}

/**
 * Return the camera of an affine matrix: the products of its axes with an offset from its position are the coordinates of
 * the offset in camera space.
 */
function dualCamera(lpsFromCamera: readonly number[]): Camera {
  const { right, down, forward, position } = cameraFromMatrix(lpsFromCamera);
  const volume = dot(right, cross(down, forward));
  return {
    right: scale(cross(down, forward), 1 / volume),
    down: scale(cross(forward, right), 1 / volume),
    forward: scale(cross(right, down), 1 / volume),
    position,
  };
}

/** Return the patient point (LPS mm) of a pixel in a planar picture. */
export function lpsFromPixel(geometry: FlatGeometry, pixel: PixelPoint): Vec3 {
  return add(geometry.origin, add(scale(geometry.perColumn, pixel.column), scale(geometry.perRow, pixel.row)));
}

/** Return the unit normal of a planar picture that points into the screen: right x down, as for a camera. */
export function normalOf(geometry: FlatGeometry): Vec3 {
  return unit(cross(geometry.perColumn, geometry.perRow));
}

/** Return the size of a pixel in a planar picture, mm. */
export function mmPerPixel(geometry: FlatGeometry): number {
  return Math.sqrt(dot(geometry.perColumn, geometry.perColumn));
}

/**
 * Return the position of a patient point (LPS mm) in a picture; null if the point is behind the camera or too near to
 * it.
 */
export function pixelFromLps(geometry: Geometry, lps: Vec3): SeenPoint | null {
  if (geometry.kind === "flat") {
    const offset = sub(lps, geometry.origin);
    // Solve by least squares over both axes, so that the result is exact even if the axes are not exactly
    // perpendicular.
    const cc = dot(geometry.perColumn, geometry.perColumn);
    const rr = dot(geometry.perRow, geometry.perRow);
    const cr = dot(geometry.perColumn, geometry.perRow);
    const det = cc * rr - cr * cr;
    if (!(det > 0)) return null;
    const oc = dot(offset, geometry.perColumn);
    const or = dot(offset, geometry.perRow);
    return {
      column: (oc * rr - or * cr) / det,
      row: (or * cc - oc * cr) / det,
      depthMm: dot(offset, normalOf(geometry)),
    };
  }
  const offset = sub(lps, geometry.camera.position);
  const depthMm = dot(offset, geometry.camera.forward);
  if (geometry.lens !== null) {
    const pixel = throughLens(
      geometry.lens,
      dot(offset, geometry.camera.right),
      dot(offset, geometry.camera.down),
      depthMm,
    );
    return pixel === null ? null : { ...pixel, depthMm };
  }
  if (depthMm < NEAR_MM) return null;
  return {
    column: geometry.width / 2 + (geometry.focalPx * dot(offset, geometry.camera.right)) / depthMm,
    row: geometry.height / 2 + (geometry.focalPx * dot(offset, geometry.camera.down)) / depthMm,
    depthMm,
  };
}

/**
 * Return the position in the picture of a point in camera space, mm; null if the lens does not image the point. The
 * protocol's PictureLens defines the formulas.
 */
function throughLens(lens: PictureLens, x: number, y: number, z: number): PixelPoint | null {
  const across = Math.hypot(x, y);
  const angle = Math.atan2(across, z);
  if (Math.hypot(across, z) < NEAR_MM || angle > Math.min(lens.limit_rad, WIDEST_LINE_RAD)) return null;
  const [k1 = 0, k2 = 0, k3 = 0, k4 = 0, k5 = 0, k6 = 0, k7 = 0, k8 = 0] = lens.coefficients;
  let at: [number, number];
  if (lens.model === "fisheye") {
    const s = angle * angle;
    const radius = angle * (1 + s * (k1 + s * (k2 + s * (k3 + s * k4))));
    at = across === 0 ? [0, 0] : [(x / across) * radius, (y / across) * radius];
  } else {
    if (z <= 0) return null;
    // The coefficients are in OpenCV's order: k1 k2 p1 p2 k3, then k4 k5 k6 of the denominator.
    const [p1, p2] = [k3, k4];
    const [u, v] = [x / z, y / z];
    const s = u * u + v * v;
    const radial = (1 + s * (k1 + s * (k2 + s * k5))) / (1 + s * (k6 + s * (k7 + s * k8)));
    at = [u * radial + 2 * p1 * u * v + p2 * (s + 2 * u * u), v * radial + p1 * (s + 2 * v * v) + 2 * p2 * u * v];
  }
  const [fx = 0, fy = 0] = lens.focal_px;
  const [cx = 0, cy = 0] = lens.centre_px;
  return { column: cx + fx * at[0], row: cy + fy * at[1] };
}

/**
 * Maximum angle between the viewing direction and a drawn line, rad. A line behind a fisheye camera would cross the
 * whole picture; 120 degrees is beyond every corner.
 */
const WIDEST_LINE_RAD = (120 * Math.PI) / 180;

/** Depth in front of the camera, mm, below which lines are not drawn. */
export const NEAR_MM = 0.5;

/** Project a polyline to runs of picture positions; the parts that the camera cannot see are left out. */
export function projectLine(geometry: Geometry, pointsLps: readonly Vec3[]): SeenPoint[][] {
  const runs: SeenPoint[][] = [];
  let run: SeenPoint[] = [];
  for (const point of pointsLps) {
    const seen = pixelFromLps(geometry, point);
    if (seen !== null) {
      run.push(seen);
    } else if (run.length > 0) {
      runs.push(run);
      run = [];
    }
  }
  if (run.length > 0) runs.push(run);
  return runs.filter((part) => part.length > 1);
}

/** Return the patient directions of a picture's rows and columns: unit vectors to the right and down. */
export function axesOf(geometry: Geometry): { right: Vec3; down: Vec3 } {
  return geometry.kind === "flat"
    ? { right: unit(geometry.perColumn), down: unit(geometry.perRow) }
    : { right: geometry.camera.right, down: geometry.camera.down };
}

/** Return a round length in mm for a scale bar of at most `maxPx` pixels, and the bar's length in px. */
export function scaleBar(mmPerPx: number, maxPx: number): { mm: number; px: number } {
  const limit = mmPerPx * maxPx;
  const power = 10 ** Math.floor(Math.log10(limit));
  const mm = [5, 2, 1].map((step) => step * power).find((step) => step <= limit) ?? power;
  return { mm, px: mm / mmPerPx };
}
