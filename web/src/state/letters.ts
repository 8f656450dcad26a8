/** Orientation letters: which way the patient lies in a picture, always computed from the picture's own geometry. */

import { type Camera, dot, scale, unit, type Vec3 } from "./vec";

export type Letter = "R" | "L" | "A" | "P" | "S" | "I";

export const DIRECTION_LPS: Readonly<Record<Letter, Vec3>> = {
  L: [1, 0, 0],
  R: [-1, 0, 0],
  P: [0, 1, 0],
  A: [0, -1, 0],
  S: [0, 0, 1],
  I: [0, 0, -1],
};

export const LETTER_WORDS: Readonly<Record<Letter, string>> = {
  R: "right",
  L: "left",
  A: "anterior",
  P: "posterior",
  S: "superior",
  I: "inferior",
};

/** sin 12 degrees: below this a second letter would name a tilt that nobody can see. */
const SECOND_LETTER = 0.2;

/** The letters that name a direction, dominant first; two when it is oblique. */
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

export interface EdgeLetters {
  left: string;
  right: string;
  top: string;
  bottom: string;
}

/** Letters for the four edges of a picture whose columns run along `right` and rows along `down`. */
export function edgeLetters(right: Vec3, down: Vec3): EdgeLetters {
  return {
    right: lettersOf(right),
    left: lettersOf(scale(right, -1)),
    bottom: lettersOf(down),
    top: lettersOf(scale(down, -1)),
  };
}

export interface RingMark {
  /** One letter, or two (dominant first) where two directions fall on the same place of the ring. */
  text: string;
  /** Clockwise from 12 o'clock, in (-pi, pi]. */
  angleRad: number;
  /** How much of the direction lies in the image plane, 0..1. */
  strength: number;
}

/** Below this, a direction points into or out of the picture more than along it (30 degrees from the axis). */
const RING_MIN_STRENGTH = 0.5;
/** Marks closer than this would print over one another. */
const RING_MERGE_RAD = (20 * Math.PI) / 180;

/** Where the patient's directions lie round an endoluminal picture. Opposite letters always come in pairs. */
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

export function angleBetween(a: number, b: number): number {
  const d = Math.abs(a - b) % (2 * Math.PI);
  return d > Math.PI ? 2 * Math.PI - d : d;
}

/** Hour on the clock face (1..12) of an angle clockwise from 12 o'clock. */
export function clockHour(angleRad: number): number {
  const hour = Math.round((angleRad / (2 * Math.PI)) * 12);
  return ((hour + 11) % 12) + 1;
}
