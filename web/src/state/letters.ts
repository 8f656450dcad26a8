/** Orientation letters of a picture, computed from the picture's geometry. */

import { type Camera, dot, scale, unit, type Vec3 } from "./vec";

/** Letter of a patient direction. */
export type Letter = "R" | "L" | "A" | "P" | "S" | "I";

/** Unit vector of each letter's patient direction, LPS. */
export const DIRECTION_LPS: Readonly<Record<Letter, Vec3>> = {
  L: [1, 0, 0],
  R: [-1, 0, 0],
  P: [0, 1, 0],
  A: [0, -1, 0],
  S: [0, 0, 1],
  I: [0, 0, -1],
};

/** Word for each letter's patient direction. */
export const LETTER_TEXTS: Readonly<Record<Letter, string>> = {
  R: "right",
  L: "left",
  A: "anterior",
  P: "posterior",
  S: "superior",
  I: "inferior",
};

/**
 * Minimum second component of a direction that adds a second letter: sin 12 degrees, because a smaller tilt is not
 * visible.
 */
const SECOND_LETTER = 0.2;

/** Return the letters of a patient direction, dominant letter first; an oblique direction has two letters. */
export function lettersOf(dirLps: Vec3): string {
  const dir = unit(dirLps);
  const parts: { letter: Letter; size: number }[] = [
    { letter: dir[0] >= 0 ? "L" : "R", size: Math.abs(dir[0]) },
    { letter: dir[1] >= 0 ? "P" : "A", size: Math.abs(dir[1]) },
    { letter: dir[2] >= 0 ? "S" : "I", size: Math.abs(dir[2]) },
  ];
  return parts
    .sort((a, b) => b.size - a.size)
    .slice(0, 2)
    .filter((part, index) => index === 0 || part.size >= SECOND_LETTER)
    .map((part) => part.letter)
    .join("");
}

/** Orientation letters at the four edges of a picture. */
export interface EdgeLetters {
  left: string;
  right: string;
  top: string;
  bottom: string;
}

/** Return the orientation letters of a picture whose columns run along `right` and whose rows run along `down`. */
export function edgeLetters(right: Vec3, down: Vec3): EdgeLetters {
  return {
    right: lettersOf(right),
    left: lettersOf(scale(right, -1)),
    bottom: lettersOf(down),
    top: lettersOf(scale(down, -1)),
  };
}

/** A letter on the ring around the airway view. */
export interface RingMark {
  /** One letter, or two (dominant first) if two directions have the same place on the ring. */
  text: string;
  /** Angle of the mark, rad, clockwise from 12 o'clock, in (-pi, pi]. */
  angleRad: number;
  /** Length of the direction's component in the image plane, 0..1. */
  strength: number;
}

/**
 * Minimum component in the image plane of a direction on the ring. A direction within 30 degrees of the viewing axis
 * points mainly into or out of the picture.
 */
const RING_MIN_STRENGTH = 0.5;
/** Angle between two marks of the ring, rad, below which their letters would overlap. */
const RING_MERGE_RAD = (20 * Math.PI) / 180;

/**
 * Return the marks of the patient directions on the ring around an airway view. Opposite letters always occur in pairs.
 */
export function ringMarks(camera: Pick<Camera, "right" | "down">): RingMark[] {
  const marks: RingMark[] = [];
  const letters: Letter[] = ["A", "P", "R", "L", "S", "I"];
  const candidates = letters
    .map((letter) => {
      const x = dot(DIRECTION_LPS[letter], camera.right);
      const y = dot(DIRECTION_LPS[letter], camera.down);
      return { text: letter as string, angleRad: Math.atan2(x, -y), strength: Math.hypot(x, y) };
    })
    .filter((mark) => mark.strength >= RING_MIN_STRENGTH)
    .sort((a, b) => b.strength - a.strength);
  for (const mark of candidates) {
    const near = marks.find((other) => angleBetween(other.angleRad, mark.angleRad) < RING_MERGE_RAD);
    if (near === undefined) marks.push({ ...mark });
    else if (near.text.length < 2) near.text += mark.text;
  }
  return marks;
}

/** Return the absolute difference of two angles, rad, in [0, pi]. */
export function angleBetween(a: number, b: number): number {
  const d = Math.abs(a - b) % (2 * Math.PI);
  return d > Math.PI ? 2 * Math.PI - d : d;
}

/** Return the clock hour (1..12) of an angle, rad, clockwise from 12 o'clock. */
export function clockHour(angleRad: number): number {
  const hour = Math.round((angleRad / (2 * Math.PI)) * 12);
  return ((hour + 11) % 12) + 1;
}
