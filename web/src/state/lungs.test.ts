import { describe, expect, it } from "vitest";
import type { LungsMessage, StationOnRoute } from "../wire/messages";
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

describe("layers around the targets", () => {
  it("wantedLayers returns the layers that are not hidden, and never the lymph node stations.", () => {
    expect(wantedLayers([])).toEqual(["vessels", "fissures", "lobes", "reach"]);
    expect(wantedLayers(["lobes", "stations"])).toEqual(["vessels", "fissures", "reach"]);
    expect(toggled(toggled(["lobes"], "reach"), "lobes")).toEqual(["reach"]);
  });

  it("layerRows lists the available layers with their figures and limits.", () => {
    expect(layerRows(null)).toEqual([]);
    expect(layerRows(LUNGS).map(({ layer, figures, limits }) => [layer, figures, limits])).toEqual([
      ["vessels", "143 ml in both lungs", ["No mediastinum."]],
      ["stations", "7", ["Airway landmarks only."]],
    ]);
  });

  it("stationsSeen returns only stations with a point in the tree, and none while they are hidden.", () => {
    expect(stationsSeen(LUNGS, [], [])).toEqual([{ station: "7", from: [0, 0, 0], to: [12, 0, 0] }]);
    expect(stationsSeen(LUNGS, ["stations"], [])).toEqual([]);
  });

  it("stationsSeen adds the stations of the route that the slices show, and never the same station twice.", () => {
    const shown: StationOnRoute = {
      station: "7",
      head: "",
      facing: "",
      point_lps: [0, 0, 0],
      direction_lps: [1, 0, 0],
      borders: "",
      doubts: [],
    };
    const seen = { station: "7", from: [0, 0, 0], to: [12, 0, 0] };
    expect(stationsSeen(null, [], [shown])).toEqual([seen]);
    expect(stationsSeen(LUNGS, ["stations"], [shown])).toEqual([seen]);
    expect(stationsSeen(LUNGS, [], [shown])).toEqual([seen]);
    // Station 7 has a second landmark, in the other main bronchus.
    expect(stationsSeen(LUNGS, [], [{ ...shown, point_lps: [9, 0, 0] }])).toHaveLength(2);
  });

  it("vesselsSeen returns the vessel lines unless they are hidden or missing.", () => {
    expect(vesselsSeen(LUNGS, ["lobes"])).toBe(LUNGS.vessels);
    expect(vesselsSeen(LUNGS, ["vessels"])).toEqual([]);
    expect(vesselsSeen(null, [])).toEqual([]);
  });
});
