/** Colours, marks and strokes of the overlays. Red, yellow and green are reserved for the three planes. */

/** Colours of the three slice planes. */
export const PLANE_COLOURS = { axial: "#ff6f61", coronal: "#63d28c", sagittal: "#f3d34f" } as const;

/** Colours of the overlays, apart from those of the planes. */
export const INK = {
  text: "#e6e8ea",
  quiet: "#a9b1b8",
  accent: "#4fd3e6",
  warning: "#f4b44c",
  /** Outline of the lumen, in a hue that no plane, lobe or mark has. */
  lumen: "#f08ce0",
  /** A target with a size, and the needle path to it. */
  lesion: "#b79cff",
  needle: "#ffffff",
  halo: "rgba(8, 10, 12, 0.85)",
  ring: "#2c343a",
  ringTick: "#5b666e",
} as const;

/** Font family of the overlays. */
export const FONT = 'system-ui, -apple-system, "Segoe UI", Roboto, "Noto Sans", "DejaVu Sans", sans-serif';

/** Canvas context on which an overlay is drawn. */
export type Ink = CanvasRenderingContext2D;

/** A point on the screen, CSS px. */
export interface ScreenPoint {
  x: number;
  y: number;
}

/** A rectangle on the screen, CSS px. */
export interface Rect {
  x: number;
  y: number;
  width: number;
  height: number;
}

/** Draw text that is readable on any picture: light letters with a dark outline. */
export function label(
  ink: Ink,
  text: string,
  at: ScreenPoint,
  options: {
    size?: number;
    bold?: boolean;
    colour?: string;
    align?: CanvasTextAlign;
    baseline?: CanvasTextBaseline;
  } = {},
): void {
  ink.font = `${options.bold === true ? "600 " : ""}${options.size ?? 12}px ${FONT}`;
  ink.textAlign = options.align ?? "center";
  ink.textBaseline = options.baseline ?? "middle";
  ink.lineJoin = "round";
  ink.lineWidth = 3;
  ink.strokeStyle = INK.halo;
  ink.strokeText(text, at.x, at.y);
  ink.fillStyle = options.colour ?? INK.text;
  ink.fillText(text, at.x, at.y);
}

/** Draw a polyline in a colour, width (CSS px) and opacity. */
export function line(ink: Ink, points: readonly ScreenPoint[], colour: string, width: number, alpha = 1): void {
  if (points.length < 2) return;
  ink.save();
  ink.globalAlpha = alpha;
  ink.strokeStyle = colour;
  ink.lineWidth = width;
  ink.lineJoin = "round";
  ink.lineCap = "round";
  ink.beginPath();
  points.forEach((point, index) => {
    if (index === 0) ink.moveTo(point.x, point.y);
    else ink.lineTo(point.x, point.y);
  });
  ink.stroke();
  ink.restore();
}

/** Draw the mark of the tip: a disc with the viewing direction, which is hollow if the tip is off the plane. */
export function tipMark(ink: Ink, at: ScreenPoint, look: ScreenPoint | null, onPlane: boolean): void {
  ink.save();
  ink.lineWidth = 2;
  ink.strokeStyle = INK.halo;
  ink.beginPath();
  ink.arc(at.x, at.y, 6, 0, 2 * Math.PI);
  ink.stroke();
  ink.strokeStyle = INK.accent;
  ink.fillStyle = INK.accent;
  ink.beginPath();
  ink.arc(at.x, at.y, 4, 0, 2 * Math.PI);
  if (onPlane) ink.fill();
  ink.stroke();
  const size = look === null ? 0 : Math.hypot(look.x, look.y);
  if (look !== null && size > 2) {
    const ux = look.x / size;
    const uy = look.y / size;
    const reach = 6 + Math.min(size, 16);
    const tip = { x: at.x + ux * reach, y: at.y + uy * reach };
    ink.beginPath();
    ink.moveTo(at.x + ux * 5, at.y + uy * 5);
    ink.lineTo(tip.x, tip.y);
    ink.moveTo(tip.x - ux * 5 - uy * 3.5, tip.y - uy * 5 + ux * 3.5);
    ink.lineTo(tip.x, tip.y);
    ink.lineTo(tip.x - ux * 5 + uy * 3.5, tip.y - uy * 5 - ux * 3.5);
    ink.stroke();
  }
  ink.restore();
}

/**
 * Draw the mark of a tracked pen: a nib whose point is at the pen's tip, which is hollow if the tip is off the plane.
 */
export function penMark(ink: Ink, at: ScreenPoint, onPlane: boolean): void {
  ink.save();
  ink.lineJoin = "round";
  for (const [width, colour] of [
    [4, INK.halo],
    [1.5, INK.text],
  ] as const) {
    ink.lineWidth = width;
    ink.strokeStyle = colour;
    ink.beginPath();
    ink.moveTo(at.x, at.y);
    ink.lineTo(at.x + 4, at.y - 11);
    ink.lineTo(at.x + 9, at.y - 20);
    ink.lineTo(at.x + 14, at.y - 16);
    ink.lineTo(at.x + 8, at.y - 8);
    ink.closePath();
    ink.stroke();
  }
  if (onPlane) {
    ink.fillStyle = INK.text;
    ink.fill();
  }
  ink.restore();
}

/** Draw the mark of a target: a diamond. The caller passes amber if no path leads to the target. */
export function targetMark(ink: Ink, at: ScreenPoint, colour: string, alpha: number): void {
  ink.save();
  ink.globalAlpha = alpha;
  for (const [width, stroke] of [
    [4, INK.halo],
    [2, colour],
  ] as const) {
    ink.lineWidth = width;
    ink.strokeStyle = stroke;
    ink.beginPath();
    ink.moveTo(at.x, at.y - 6);
    ink.lineTo(at.x + 6, at.y);
    ink.lineTo(at.x, at.y + 6);
    ink.lineTo(at.x - 6, at.y);
    ink.closePath();
    ink.stroke();
  }
  ink.restore();
}

/**
 * Placement of names beside their marks without overlap. A name that does not fit on one side is drawn on another side,
 * or left out.
 */
export class NamePlaces {
  readonly #taken: { left: number; right: number; top: number; bottom: number }[] = [];

  /**
   * Draw a name beside its mark; return false if the name was left out. `sides` are tried in order: 1 is right of the
   * mark, -1 is left.
   */
  name(
    ink: Ink,
    text: string,
    at: ScreenPoint,
    colour: string,
    within: { width: number; height: number },
    sides: readonly (1 | -1)[] = [1, -1],
  ): boolean {
    ink.font = `11px ${FONT}`;
    const width = ink.measureText(text).width;
    for (const [side, lift] of sides.flatMap((side) => [-9, 9].map((lift) => [side, lift] as const))) {
      const left = side > 0 ? at.x + 10 : at.x - 10 - width;
      const box = { left, right: left + width, top: at.y + lift - 7, bottom: at.y + lift + 7 };
      const inside = box.left >= 2 && box.right <= within.width - 2 && box.top >= 2 && box.bottom <= within.height - 2;
      const free = this.#taken.every(
        (other) => box.right < other.left || box.left > other.right || box.bottom < other.top || box.top > other.bottom,
      );
      if (!inside || !free) continue;
      this.#taken.push(box);
      label(ink, text, { x: left, y: at.y + lift }, { size: 11, colour, align: "left" });
      return true;
    }
    return false;
  }
}

/** Draw the mark of a path's start point: a ring with a label. */
export function startMark(
  ink: Ink,
  at: ScreenPoint,
  alpha: number,
  names: NamePlaces,
  size: { width: number; height: number },
): void {
  ink.save();
  ink.globalAlpha = alpha;
  for (const [width, stroke] of [
    [4, INK.halo],
    [2, INK.accent],
  ] as const) {
    ink.lineWidth = width;
    ink.strokeStyle = stroke;
    ink.beginPath();
    ink.arc(at.x, at.y, 5, 0, 2 * Math.PI);
    ink.stroke();
  }
  ink.restore();
  if (alpha === 1) names.name(ink, "Start", at, INK.accent, size);
}
