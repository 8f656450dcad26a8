/** What was mapped round the targets, as the panel and the pictures show it. */

import type { LungsMessage, PictureLayer, Station, VesselLine } from "../wire/messages";
import { add, asVec3, scale, type Vec3 } from "./vec";

export type LayerName = PictureLayer["layer"];

/** What can be switched off: the layers of the wire, and the stations, which come with no picture. */
export type ShownLayer = LayerName | "stations";

export const LAYER_NAMES: readonly { layer: ShownLayer; title: string; words: string }[] = [
  {
    layer: "vessels",
    title: "Vessels",
    words: "Vessels of the lungs in slices and round the airway tree; dashed where less sure",
  },
  { layer: "fissures", title: "Fissures", words: "Fissures in slices, as far as the CT shows them" },
  { layer: "lobes", title: "Lobes", words: "Borders of the lobes in slices, dashed: estimated from the airways" },
  { layer: "stations", title: "EBUS stations", words: "Where to look for lymph node stations, from the airways alone" },
  { layer: "reach", title: "Reach", words: "Where the tool gets to, in slices; dashed: may reach" },
];

export const WIRE_LAYERS: readonly LayerName[] = ["vessels", "fissures", "lobes", "reach"];

/** What the server is asked to send with the pictures. */
export const wantedLayers = (hidden: readonly ShownLayer[]): LayerName[] =>
  WIRE_LAYERS.filter((layer) => !hidden.includes(layer));

export const toggled = (hidden: readonly ShownLayer[], layer: ShownLayer): ShownLayer[] =>
  hidden.includes(layer) ? hidden.filter((one) => one !== layer) : [...hidden, layer];

/** Beyond the wall of the airway: as far as the direction is drawn. */
const LOOK_MM = 12;

export interface SeenStation {
  readonly station: string;
  readonly from: Vec3;
  readonly to: Vec3;
}

export function stationsSeen(lungs: LungsMessage | null, hidden: readonly ShownLayer[]): SeenStation[] {
  if (lungs === null || hidden.includes("stations")) return [];
  return lungs.stations.flatMap(({ station, point_lps: point, direction_lps: direction }: Station) => {
    if (point === null || direction === null) return [];
    const from = asVec3(point);
    return [{ station, from, to: add(from, scale(asVec3(direction), LOOK_MM)) }];
  });
}

const NO_VESSELS: readonly VesselLine[] = [];

/** The vessels as lines, where they are shown. */
export const vesselsSeen = (lungs: LungsMessage | null, hidden: readonly ShownLayer[]): readonly VesselLine[] =>
  lungs === null || hidden.includes("vessels") ? NO_VESSELS : lungs.vessels;

export interface LayerRow {
  readonly layer: ShownLayer;
  readonly title: string;
  readonly words: string;
  /** What it shows, in figures. */
  readonly told: string;
  readonly limits: readonly string[];
  /** Those that have a colour each: lobes. */
  readonly parts: readonly string[];
}

/** The layers that there are, in their order. */
export function layerRows(lungs: LungsMessage | null): LayerRow[] {
  if (lungs === null) return [];
  return LAYER_NAMES.flatMap((row) => {
    if (row.layer === "stations") {
      const placed = lungs.stations.filter(({ point_lps: point }) => point !== null);
      const told = [...new Set(placed.map(({ station }) => station))].join(", ");
      return lungs.stations.length === 0
        ? []
        : [{ ...row, told: told === "" ? "none placed" : told, limits: [lungs.station_limits], parts: [] }];
    }
    const found = lungs.layers.find(({ layer }) => layer === row.layer);
    return found === undefined ? [] : [{ ...row, told: found.words, limits: found.limits, parts: found.parts }];
  });
}
