/** Numbers as text for the user, with units and with minus signs that align. */

import { asVec3, type Vec3 } from "./vec";

const MINUS = "\u2212";
const THIN = "\u202f";

/** Return a number as text with a fixed number of decimals and a true minus sign. */
export function fixed(value: number, digits = 0): string {
  const text = Math.abs(value).toFixed(digits);
  return value < 0 && Number(text) !== 0 ? `${MINUS}${text}` : text;
}

/** Return a length as text in mm, with its unit. */
export const mm = (value: number, digits = 1): string => `${fixed(value, digits)}${THIN}mm`;

/** Return patient coordinates as text with side letters: `R 17.6  P 35.3  S 12.1 mm`. */
export function coordinates(lps: Vec3): string {
  const part = (value: number, plus: string, minus: string) =>
    `${value >= 0 ? plus : minus}${THIN}${Math.abs(value).toFixed(1)}`;
  return `${part(lps[0], "L", "R")}  ${part(lps[1], "P", "A")}  ${part(lps[2], "S", "I")} mm`;
}

const SIDES: Readonly<Record<string, readonly [axis: 0 | 1 | 2, sign: 1 | -1]>> = {
  L: [0, 1],
  R: [0, -1],
  P: [1, 1],
  A: [1, -1],
  S: [2, 1],
  I: [2, -1],
};

/**
 * Parse coordinates in the form `x, y, z` in LPS mm (separators: comma, semicolon, space; hyphen or true minus) or with
 * side letters, `R 17.6 P 35.3 S 12.1`. Return null for any other text.
 */
export function parseCoordinates(text: string): Vec3 | null {
  const plain = text
    .replaceAll(MINUS, "-")
    .replace(/\s*mm\s*$/i, "")
    .trim();
  const parts = plain.split(/[\s,;]+/);
  const values = parts.map(Number);
  if (parts.length === 3 && parts.every((part) => part !== "") && values.every(Number.isFinite)) return asVec3(values);
  return fromSides(plain);
}

/**
 * Parse coordinates with side letters. Each axis must occur once and without a sign, because a sign beside a letter is
 * ambiguous; return null otherwise.
 */
function fromSides(text: string): Vec3 | null {
  const matches = [...text.toUpperCase().matchAll(/([LRPASI])\s*(\d+(?:\.\d+)?)/g)];
  const rest = text.toUpperCase().replace(/([LRPASI])\s*(\d+(?:\.\d+)?)/g, "");
  if (matches.length !== 3 || /[^\s,;]/.test(rest)) return null;
  const found: (number | null)[] = [null, null, null];
  for (const [, side, mm] of matches) {
    const place = SIDES[side ?? ""];
    if (place === undefined) return null;
    found[place[0]] = place[1] * Number(mm);
  }
  // If an axis occurs twice, another axis has no number, and the text is rejected.
  const [x, y, z] = found;
  return x == null || y == null || z == null ? null : [x, y, z];
}

/** Return the remaining time of a job as text, `about 40 s left`, rounded to the accuracy of the estimate. */
export function timeLeft(seconds: number): string {
  if (seconds < 2) return "almost done";
  if (seconds < 60) return `about ${Math.ceil(seconds / 5) * 5} s left`;
  return `about ${Math.ceil(seconds / 60)} min left`;
}

/** Return window width and level as text, `W 1500  L -600`. */
export const windowText = (widthHu: number, levelHu: number): string => `W ${fixed(widthHu)}  L ${fixed(levelHu)}`;

/** Return the angles of a C-arm as texts, in the words of a plan's C-arm angles: `LAO 30\u00b0`, `cranial 15\u00b0`. */
export function carmText(carm: { primary_deg: number; secondary_deg: number }): string[] {
  const primary = Math.round(carm.primary_deg);
  const secondary = Math.round(carm.secondary_deg);
  const first = primary === 0 ? "AP" : `${primary > 0 ? "LAO" : "RAO"} ${Math.abs(primary)}\u00b0`;
  return secondary === 0 ? [first] : [first, `${secondary > 0 ? "cranial" : "caudal"} ${Math.abs(secondary)}\u00b0`];
}

/** Return a text of the server with a capital first letter, as a sentence. */
export const sentence = (words: string): string => words.charAt(0).toUpperCase() + words.slice(1);

/** Return a count with its noun in the singular or plural. */
export const plural = (count: number, one: string, many = `${one}s`): string => `${count} ${count === 1 ? one : many}`;

/** The finest ray step of the airway view, in units of the smallest voxel spacing. */
const FINE_STEP_VOX = 0.5;

/**
 * Return the resolution of an airway picture as text: `reduced: 40 %`, with the ray step if it is longer than the
 * finest one.
 */
export function finenessText(picture: { width: number; step_vox: number | null }, wantedWidth: number): string {
  const percent = Math.min(Math.round((100 * picture.width) / Math.max(wantedWidth, 1)), 100);
  const step = picture.step_vox ?? FINE_STEP_VOX;
  if (percent >= 100 && step <= FINE_STEP_VOX) return "full resolution";
  const stepText = step > FINE_STEP_VOX ? `, step ${fixed(step, 1)} voxels` : "";
  return `reduced: ${percent} %${stepText}`;
}

/**
 * Return the method that rendered the displayed picture, as text, compared with the requested method; `made` is null
 * before the first picture.
 */
export function methodText(made: string | null, requested: "leap" | "brute"): string {
  const method = (made ?? requested).replace(/^gpu-/, "");
  if (method.startsWith("leap")) return "fast rendering";
  if (method !== "brute") return "cut-plane";
  return requested === "leap" ? "full sampling until fast rendering is ready" : "full sampling";
}

/** Return a time (s since 1970) as time of day, with the date if it is not today. */
export function clock(sinceEpochS: number, nowMs: number): string {
  const then = new Date(1000 * sinceEpochS);
  const time = `${String(then.getHours()).padStart(2, "0")}:${String(then.getMinutes()).padStart(2, "0")}`;
  const day = (date: Date) =>
    `${date.getFullYear()}-${String(date.getMonth() + 1).padStart(2, "0")}-${String(date.getDate()).padStart(2, "0")}`;
  return day(then) === day(new Date(nowMs)) ? time : `${day(then)} ${time}`;
}

/** Return a duration as text: `12:05 min`. */
export function agoText(seconds: number): string {
  const whole = Math.round(seconds);
  return `${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, "0")} min`;
}

/** Facts about a series of a folder that distinguish it from the others. */
interface SeriesFacts {
  readonly modality: string;
  readonly description: string;
  readonly num_slices: number;
  readonly slice_distance_mm: number | null;
  readonly thickness_mm: number | null;
  readonly kernel: string;
  readonly phase: string;
  readonly acquired_on: string | null;
}

/** Return the description of a series, or its modality without one. */
export const seriesTitle = (series: SeriesFacts): string => series.description || series.modality;

/** Return the facts of a series as text: number, distance and thickness of its slices, kernel, phase and date. */
export function seriesFacts(series: SeriesFacts): string {
  const title = seriesTitle(series);
  const facts = [
    `${series.num_slices} ${series.num_slices === 1 ? "slice" : "slices"}`,
    series.slice_distance_mm === null ? "" : `every ${mm(series.slice_distance_mm, 2)}`,
    series.thickness_mm === null ? "" : `${mm(series.thickness_mm, 2)} thick`,
    series.kernel === "" || title.includes(series.kernel) ? "" : `kernel ${series.kernel}`,
    series.phase,
    series.acquired_on ?? "",
  ];
  return facts.filter((fact) => fact !== "").join(", ");
}
