/** Lung structures that were mapped around the targets, for the panel and the views. */

import type { LungsMessage, PictureLayer, Station, StationOnRoute, VesselLine } from "../wire/messages";
import { add, asVec3, scale, sub, type Vec3 } from "./vec";

/** Name of a layer in the protocol. */
export type LayerName = PictureLayer["layer"];

/**
 * A layer that the user can hide: the layers of the protocol, and the lymph node stations, which are not part of a
 * picture.
 */
export type ShownLayer = LayerName | "stations";

/** All layers with titles and explanations, in display order. */
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

/** Layers that the server sends with pictures. */
export const WIRE_LAYERS: readonly LayerName[] = ["vessels", "fissures", "lobes", "reach"];

/** Return the layers that the client requests from the server: those that are not hidden. */
export const wantedLayers = (hidden: readonly ShownLayer[]): LayerName[] =>
  WIRE_LAYERS.filter((layer) => !hidden.includes(layer));

/** Return the hidden layers after the visibility of one layer was switched. */
export const toggled = (hidden: readonly ShownLayer[], layer: ShownLayer): ShownLayer[] =>
  hidden.includes(layer) ? hidden.filter((one) => one !== layer) : [...hidden, layer];

/** Length, mm, of the line that marks the direction of a lymph node station, from its point in the airway. */
const LOOK_MM = 12;

/** A lymph node station as drawn in a view. */
export interface SeenStation {
  readonly station: string;
  readonly from: Vec3;
  readonly to: Vec3;
}

/**
 * Return the visible lymph node stations whose airway point is in the tree. `shown` are the stations of the route that
 * the slices show, which are visible also while the others are hidden or not mapped.
 */
export function stationsSeen(
  lungs: LungsMessage | null,
  hidden: readonly ShownLayer[],
  shown: readonly StationOnRoute[],
): SeenStation[] {
  const mapped = lungs === null || hidden.includes("stations") ? [] : lungs.stations.flatMap(seenStation);
  // A station of the route that is also in the map is the same landmark, so only the one of the map is drawn.
  const alone = shown
    .flatMap(seenStation)
    .filter(
      ({ station, from }) =>
        !mapped.some((one) => one.station === station && Math.hypot(...sub(one.from, from)) < 0.05),
    );
  return [...mapped, ...alone];
}

function seenStation({ station, point_lps: point, direction_lps: direction }: Station | StationOnRoute): SeenStation[] {
  if (point === null || direction === null) return [];
  const from = asVec3(point);
  return [{ station, from, to: add(from, scale(asVec3(direction), LOOK_MM)) }];
}

const NO_VESSELS: readonly VesselLine[] = [];

/** Return the vessel lines; an empty list while they are hidden. */
export const vesselsSeen = (lungs: LungsMessage | null, hidden: readonly ShownLayer[]): readonly VesselLine[] =>
  lungs === null || hidden.includes("vessels") ? NO_VESSELS : lungs.vessels;

/** A row of the list of layers in the panel. */
export interface LayerRow {
  readonly layer: ShownLayer;
  readonly title: string;
  readonly words: string;
  /** Contents of the layer in figures, as text. */
  readonly figures: string;
  readonly limits: readonly string[];
  /** Names of the layer's parts that have separate colours, such as lobes. */
  readonly parts: readonly string[];
}

/** Return the rows of the available layers in display order. */
export function layerRows(lungs: LungsMessage | null): LayerRow[] {
  if (lungs === null) return [];
  return LAYER_NAMES.flatMap((row) => {
    if (row.layer === "stations") {
      const placed = lungs.stations.filter(({ point_lps: point }) => point !== null);
      const figures = [...new Set(placed.map(({ station }) => station))].join(", ");
      return lungs.stations.length === 0
        ? []
        : [{ ...row, figures: figures === "" ? "none placed" : figures, limits: [lungs.station_limits], parts: [] }];
    }
    const found = lungs.layers.find(({ layer }) => layer === row.layer);
    return found === undefined ? [] : [{ ...row, figures: found.words, limits: found.limits, parts: found.parts }];
  });
}
