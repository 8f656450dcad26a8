/**
 * Overlay of the lung structures around the targets on slices and the cut-plane: vessels, fissures, lobes, lymph node
 * stations, and the reach of a tool.
 */

import type { LayerName, ShownLayer } from "../state/lungs";
import { INK, type Ink, label, type NamePlaces } from "./ink";
import { LOBE_COLOURS } from "./overlay-names";
import type { Scene } from "./scene";
import type { Viewport } from "./viewport";

interface Style {
  readonly stroke: number;
  /** Opacity of the filled inside of a structure; 0 draws no fill. */
  readonly fill: number;
  readonly alpha: number;
  readonly dash: readonly number[];
  readonly widthPx: number;
}

/** Line styles by layer and part. Uncertain parts are dashed, fainter, and not filled. */
const STYLES: Readonly<Record<LayerName, Readonly<Record<string, Style>>>> = {
  vessels: {
    sure: { stroke: 1, fill: 0.16, alpha: 0.95, dash: [], widthPx: 1 },
    unsure: { stroke: 1, fill: 0, alpha: 0.6, dash: [2, 2.5], widthPx: 1 },
  },
  fissures: { seen: { stroke: 0, fill: 0.85, alpha: 1, dash: [], widthPx: 0 } },
  lobes: { "": { stroke: 1, fill: 0.07, alpha: 0.8, dash: [7, 5], widthPx: 1.25 } },
  reach: {
    sure: { stroke: 1, fill: 0.16, alpha: 0.85, dash: [], widthPx: 1.25 },
    unsure: { stroke: 1, fill: 0, alpha: 0.6, dash: [4, 4], widthPx: 1 },
  },
};

const LAYER_COLOURS = {
  vessels: "#7d9bff",
  fissures: "#f5efdf",
  reach: INK.accent,
  stations: "#ffb3c7",
} as const;

/** Return the colour of a layer in the pictures and in the list; `part` selects the colour of a lobe. */
export function layerColour(layer: ShownLayer, part = ""): string {
  if (layer !== "lobes") return LAYER_COLOURS[layer];
  return part in LOBE_COLOURS ? LOBE_COLOURS[part as keyof typeof LOBE_COLOURS] : INK.quiet;
}

const styleOf = (layer: LayerName, part: string): Style | undefined => STYLES[layer][part] ?? STYLES[layer][""];

/** Draw the layers of the displayed picture. */
export function paintLayers(ink: Ink, viewport: Viewport, scene: Scene): void {
  const { header, layers } = viewport;
  if (header === null || layers.length === 0) return;
  const origin = viewport.screenAt({ column: 0, row: 0 });
  const end = viewport.screenAt({ column: header.width, row: header.height });
  const [perColumn, perRow] = [(end.x - origin.x) / header.width, (end.y - origin.y) / header.height];
  const ragged = new Set<LayerName>();
  for (const { layer, part, path, place, complete } of layers) {
    const style = styleOf(layer, part);
    if (scene.hiddenLayers.includes(layer) || style === undefined) continue;
    if (!complete) ragged.add(layer);
    const [a, b, c, d, e, f] = place;
    const perUnit = Math.sqrt(Math.abs((a * d - b * c) * perColumn * perRow));
    if (!(perUnit > 0)) continue;
    ink.save();
    ink.beginPath();
    ink.rect(origin.x, origin.y, end.x - origin.x, end.y - origin.y);
    ink.clip();
    ink.translate(origin.x, origin.y);
    ink.scale(perColumn, perRow);
    ink.transform(a, b, c, d, e, f);
    ink.fillStyle = ink.strokeStyle = layerColour(layer, part);
    if (style.fill > 0) {
      ink.globalAlpha = style.fill;
      ink.fill(path, "evenodd");
    }
    if (style.stroke > 0) {
      ink.globalAlpha = style.alpha;
      ink.lineWidth = style.widthPx / perUnit;
      ink.setLineDash(style.dash.map((px) => px / perUnit));
      ink.lineJoin = "round";
      ink.stroke(path);
    }
    ink.restore();
  }
  for (const [n, layer] of [...ragged].entries()) {
    const at = { x: viewport.size.width / 2, y: viewport.size.height - 48 - 14 * n };
    label(ink, `no outline of the ${layer}: too irregular`, at, { size: 11, colour: INK.warning });
  }
}

/**
 * Draw the lymph node stations. A station is a point in an airway with a direction; Carina neither detects nor draws
 * lymph nodes.
 */
export function paintStations(
  ink: Ink,
  viewport: Viewport,
  scene: Scene,
  names: NamePlaces,
  seen: (lps: readonly [number, number, number]) => { x: number; y: number; near: boolean } | null,
): void {
  for (const { station, from, to } of scene.stations) {
    const [at, end] = [seen(from), seen(to)];
    if (at === null || end === null || !at.near) continue;
    const away = Math.hypot(end.x - at.x, end.y - at.y);
    ink.save();
    for (const [width, colour] of [
      [3.5, INK.halo],
      [1.5, LAYER_COLOURS.stations],
    ] as const) {
      ink.lineWidth = width;
      ink.strokeStyle = colour;
      ink.beginPath();
      ink.arc(at.x, at.y, 3, 0, 2 * Math.PI);
      ink.stroke();
      if (away < 4) continue;
      // Dash the line, because it is the direction in which to search for the lymph node, not a detected node.
      ink.setLineDash([3, 2]);
      ink.beginPath();
      ink.moveTo(at.x, at.y);
      ink.lineTo(end.x, end.y);
      ink.stroke();
      ink.setLineDash([]);
    }
    ink.restore();
    names.name(ink, station, away < 4 ? at : end, LAYER_COLOURS.stations, viewport.size);
  }
}
