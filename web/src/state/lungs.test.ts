import { describe, expect, it } from "vitest";
import type { LungsMessage } from "../wire/messages";
import { layerRows, stationsSeen, toggled, vesselsSeen, wantedLayers } from "./lungs";

const LUNGS: LungsMessage = {
  type: "lungs",
  standing: "had",
  reach_standing: "unwanted",
  layers: [{ layer: "vessels", words: "143 ml in both lungs", limits: ["No mediastinum."], parts: [] }],
  vessels: [
    {
      points_lps: [
        [0, 0, 0],
        [0, 0, 9],
      ],
      diameter_mm: 2,
      sure: true,
    },
  ],
  stations: [
    { station: "7", words: "", point_lps: [0, 0, 0], direction_lps: [1, 0, 0], borders: "", doubts: [] },
    { station: "11L", words: "", point_lps: null, direction_lps: null, borders: "", doubts: [] },
  ],
  station_limits: "Airway landmarks only.",
  problems: [],
  outdated: false,
};

describe("layers round the targets", () => {
  it("are asked for but for those that are switched off, and stations need no picture", () => {
    expect(wantedLayers([])).toEqual(["vessels", "fissures", "lobes", "reach"]);
    expect(wantedLayers(["lobes", "stations"])).toEqual(["vessels", "fissures", "reach"]);
    expect(toggled(toggled(["lobes"], "reach"), "lobes")).toEqual(["reach"]);
  });

  it("are listed where there are any, each with its limits", () => {
    expect(layerRows(null)).toEqual([]);
    expect(layerRows(LUNGS).map(({ layer, told, limits }) => [layer, told, limits])).toEqual([
      ["vessels", "143 ml in both lungs", ["No mediastinum."]],
      ["stations", "7", ["Airway landmarks only."]],
    ]);
  });

  it("draw a station only where the tree shows its airways", () => {
    expect(stationsSeen(LUNGS, [])).toEqual([{ station: "7", from: [0, 0, 0], to: [12, 0, 0] }]);
    expect(stationsSeen(LUNGS, ["stations"])).toEqual([]);
  });

  it("have vessels round the tree while these are switched on", () => {
    expect(vesselsSeen(LUNGS, ["lobes"])).toBe(LUNGS.vessels);
    expect(vesselsSeen(LUNGS, ["vessels"])).toEqual([]);
    expect(vesselsSeen(null, [])).toEqual([]);
  });
});
