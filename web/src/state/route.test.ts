import { describe, expect, it } from "vitest";
import { type RouteInfo, STRAIGHT_AHEAD } from "../wire/messages";
import { buildTree, lineage, mainLeaf, neighbourBranch, onwardBranches } from "./airways";
import { testBranch } from "./branches.testing";
import { forkAhead } from "./fork";
import { coordinates, fixed, parseCoordinates, timeLeft } from "./format";
import {
  directionAt,
  multiplesBetween,
  nearestMm,
  nextStopMm,
  originText,
  pastMm,
  pathAtMm,
  placeText,
  pointAt,
  pointsBetween,
  scaleMm,
  sideText,
} from "./route";
import type { Camera } from "./vec";

const ROUTE: RouteInfo = {
  route_id: "r",
  title: "left",
  target_id: null,
  branch_id: 2,
  points_lps: [
    [0, 0, 0],
    [0, 0, -10],
    [0, 0, -30],
    [10, 0, -30],
  ],
  cumulative_mm: [0, 10, 30, 40],
  generation: [0, 0, 0, 1],
  radius_mm: [9, 8, 7, 2.5],
  wall_mm: [8, 6, 2, 2.4],
  forks_mm: [30],
  lookouts_mm: [15],
  spans: [
    { branch_id: 0, name: "Trachea", generation: 0, from_mm: 0, to_mm: 30, kind: "tracked" },
    { branch_id: 2, name: null, generation: 1, from_mm: 30, to_mm: 40, kind: "tracked" },
  ],
  lumen_known: true,
  narrowest_mm: null,
  narrowest_error_mm: null,
  narrowest_at_mm: null,
  scope_fits: [],
  origin: { kind: "root", along_mm: 0 },
  centreline_mm: [0, 10, 30, 40],
  needle: null,
  length_mm: 40,
  drawn_mm: 0,
  bridge_mm: 0,
};

function branch(id: number, parent: number | null, children: number[], points: [number, number, number][], r: number) {
  return testBranch(id, parent, children, { points, radius: points.map(() => r) });
}

const TREE = buildTree({
  format: "carina-tree",
  version: 1,
  space: "LPS",
  unit: "mm",
  root: 0,
  branches: [
    branch(0, null, [1, 2], [[0, 0, 0], [0, 0, -30]], 9),
    branch(1, 0, [3], [[0, 0, -30], [-10, 0, -40]], 7),
    branch(2, 0, [], [[0, 0, -30], [10, 0, -30]], 6),
    branch(3, 1, [], [[-10, 0, -40], [-20, 0, -50]], 4),
  ],
}); // biome-ignore format: points in one line each

/** Camera that looks from the head, with anterior up: the patient's right is at the right of the picture. */
const FROM_HEAD: Camera = { right: [-1, 0, 0], down: [0, 1, 0], forward: [0, 0, -1], position: [0, 0, 0] };

describe("positions along the route", () => {
  it("The next stop is the viewpoint before the next fork, then the end of the route.", () => {
    expect(nextStopMm(ROUTE, 0)).toBe(15);
    expect(nextStopMm(ROUTE, 14)).toBe(15);
    expect(nextStopMm(ROUTE, 15)).toBe(40);
  });

  it("pointAt interpolates between points, clamps beyond the ends, and returns null without points.", () => {
    expect(pointAt(ROUTE, 20)).toEqual([0, 0, -20]);
    expect(pointAt(ROUTE, 35)).toEqual([5, 0, -30]);
    expect(pointAt(ROUTE, 99)).toEqual([10, 0, -30]);
    expect(pointAt(ROUTE, -5)).toEqual([0, 0, 0]);
    expect(pointAt({ points_lps: [], cumulative_mm: [] }, 3)).toBeNull();
  });

  it("pointsBetween includes both ends of the section.", () => {
    expect(pointsBetween(ROUTE, 25, 35)).toEqual([
      [0, 0, -25],
      [0, 0, -30],
      [5, 0, -30],
    ]);
  });

  it("multiplesBetween returns the multiples of a step between two values, on both sides of 0.", () => {
    expect(multiplesBetween(-25, 20, 10)).toEqual([-20, -10, 0, 10, 20]);
    expect(multiplesBetween(3, 8, 10)).toEqual([]);
  });

  it("directionAt returns the direction of the route, and nearestMm the position nearest to a point.", () => {
    expect(directionAt(ROUTE, 20)).toEqual([0, 0, -1]);
    expect(nearestMm(ROUTE, [3, 3, -9])).toBe(10);
  });
});

describe("airway tree", () => {
  if (TREE === null) throw new Error("the tree has a root");

  it("The body side comes from geometry: +x is left.", () => {
    expect(TREE.root.side).toBe("middle");
    expect(TREE.byId.get(1)?.side).toBe("right");
    expect(TREE.byId.get(3)?.side).toBe("right");
    expect(TREE.byId.get(2)?.side).toBe("left");
  });

  it("The sides are correct for a root in the middle of the trachea, with one branch up and one down.", () => {
    const made = buildTree({
      format: "carina-tree",
      version: 1,
      space: "LPS",
      unit: "mm",
      root: 0,
      branches: [
        branch(0, null, [1, 2], [[0, 0, 0], [2, 0, 0]], 9),
        branch(1, 0, [3, 4], [[2, 0, 0], [0, 0, -40]], 9),
        branch(2, 0, [], [[2, 0, 0], [4, 0, 60]], 9),
        branch(3, 1, [5, 6], [[0, 0, -40], [-30, 0, -60]], 7),
        branch(4, 1, [], [[0, 0, -40], [50, 0, -60]], 7),
        branch(5, 3, [], [[-30, 0, -60], [-20, 0, -90]], 4),
        branch(6, 3, [], [[-30, 0, -60], [-60, 0, -90]], 4),
      ],
    }); // biome-ignore format: points in one line each
    const sides = [0, 1, 2, 3, 4, 5, 6].map((id) => made?.byId.get(id)?.side);
    expect(sides).toEqual(["middle", "middle", "middle", "right", "left", "right", "right"]);
  });

  it("mainLeaf follows the widest child at each fork, and lineage returns the ancestors from the root.", () => {
    expect(mainLeaf(TREE.root).branch.id).toBe(3);
    expect(lineage(TREE, 3).map((node) => node.branch.id)).toEqual([0, 1, 3]);
  });

  it("onwardBranches orders the branches from left to right in the picture, not in the patient.", () => {
    const ways = onwardBranches(TREE.root, FROM_HEAD, ROUTE);
    expect(ways.map((way) => way.node.branch.id)).toEqual([2, 1]);
    expect(ways.map((way) => way.chosen)).toEqual([true, false]);
    expect(ways.map((way) => way.hour)).toEqual([9, 3]);
    const facing = onwardBranches(TREE.root, { ...FROM_HEAD, right: [1, 0, 0], down: [0, -1, 0] }, ROUTE);
    expect(facing.map((way) => way.node.branch.id)).toEqual([1, 2]);
  });

  it("A branch in the middle of the picture has no clock hour, and the other branch has one.", () => {
    // The camera is at the entrance of the left branch and looks along the branch.
    const into: Camera = { right: [0, 0, -1], down: [0, 1, 0], forward: [1, 0, 0], position: [-20, 0, -31] };
    const ways = onwardBranches(TREE.root, into, ROUTE);
    expect(ways.map((way) => [way.node.branch.id, way.hour])).toEqual([
      [2, null],
      [1, 3],
    ]);
  });

  /** Return the openings of the root's children at angles in degrees to the line of sight, at clock hours. */
  const listedAt = (...places: [number, number][]) => {
    const ways = TREE.root.children.map((node, index) => {
      const [deg, hour] = places[index] ?? [0, 0];
      const [off, turn] = [(deg * Math.PI) / 180, (hour * Math.PI) / 6];
      const across = 30 * Math.sin(off);
      const at = [-across * Math.sin(turn), -across * Math.cos(turn), -30 * Math.cos(off)] as [number, number, number];
      return {
        node,
        opening: {
          branch_id: node.branch.id,
          middle_lps: at,
          in_view: true,
          straight_ahead: false,
          ahead_deg: STRAIGHT_AHEAD.most_deg,
        },
      };
    });
    return onwardBranches(TREE.root, FROM_HEAD, ROUTE, { ways, doubtful: false, atViewpoint: false })
      .sort((a, b) => a.node.branch.id - b.node.branch.id)
      .map(({ hour, noHour }) => hour ?? noHour);
  };

  it("An opening is straight ahead by the server's limits of its angle and of the other openings' angles.", () => {
    const { most_deg, times } = STRAIGHT_AHEAD;
    expect(listedAt([most_deg - 0.1, 3], [times * most_deg, 9])).toEqual(["straight ahead", 9]);
    expect(listedAt([most_deg + 0.1, 3], [40, 9])).toEqual([3, 9]);
    expect(listedAt([most_deg - 0.1, 3], [times * (most_deg - 0.2), 9])).toEqual([3, 9]);
  });

  it("Openings with the same clock hour have no clock hour, unless one of them is straight ahead.", () => {
    expect(listedAt([20, 3.2], [40, 2.8])).toEqual(["no clock hour", "no clock hour"]);
    expect(listedAt([3, 3], [40, 3])).toEqual(["straight ahead", 3]);
  });

  it("neighbourBranch returns the next branch on that side, and null at the outermost branch.", () => {
    const ways = onwardBranches(TREE.root, FROM_HEAD, ROUTE);
    expect(neighbourBranch(ways, 1)?.node.branch.id).toBe(1);
    expect(neighbourBranch(ways, -1)).toBeNull();
  });

  it("At the viewpoint of a turn, onwardBranches states the listed directions and hours that are not given.", () => {
    const opening = { middle_lps: null, in_view: true, straight_ahead: false, ahead_deg: STRAIGHT_AHEAD.most_deg };
    const [one, other] = TREE.root.children;
    if (one === undefined || other === undefined) throw new Error("the root has two children");
    const ways = [
      { node: one, opening: { ...opening, branch_id: one.branch.id } },
      { node: other, opening: { ...opening, branch_id: other.branch.id, in_view: false } },
    ];
    const texts = (doubtful: boolean) =>
      onwardBranches(TREE.root, FROM_HEAD, ROUTE, { ways, doubtful, atViewpoint: true })
        .sort((a, b) => a.node.branch.id - b.node.branch.id)
        .map(({ hour, noHour }) => hour ?? noHour);
    expect(texts(false)).toEqual([3, "not in view"]);
    expect(texts(true)).toEqual(["no clock hour", "not in view"]);
  });

  it("forkAhead returns the next fork, and a fork just reached until the tip is past it.", () => {
    expect(forkAhead(TREE, ROUTE, 10, FROM_HEAD)).toMatchObject({ distanceMm: 20, near: true });
    expect(
      forkAhead(
        TREE,
        { ...ROUTE, spans: [{ branch_id: 0, name: null, generation: 0, from_mm: 0, to_mm: 99, kind: "tracked" }] },
        10,
        FROM_HEAD,
      )?.near,
    ).toBe(false);
    expect(forkAhead(TREE, ROUTE, 30, FROM_HEAD)?.distanceMm).toBe(0);
    expect(forkAhead(TREE, ROUTE, 38, FROM_HEAD)).toBeNull();
    // At the viewpoint of the second of two forks a few millimetres apart, the second fork is selected.
    const short: RouteInfo = {
      ...ROUTE,
      forks_mm: [30, 33],
      lookouts_mm: [15, 31.5],
      spans: [
        { branch_id: 0, name: null, generation: 0, from_mm: 0, to_mm: 30, kind: "tracked" },
        { branch_id: 0, name: null, generation: 1, from_mm: 30, to_mm: 33, kind: "tracked" },
      ],
    };
    expect(forkAhead(TREE, short, 30.5, FROM_HEAD)?.distanceMm).toBe(0);
    expect(forkAhead(TREE, short, 31.5, FROM_HEAD)?.distanceMm).toBe(1.5);
  });

  it("A tree with a cycle is built without an endless loop.", () => {
    const looped = buildTree({
      format: "carina-tree",
      version: 1,
      space: "LPS",
      unit: "mm",
      root: 0,
      branches: [branch(0, null, [1], [[0, 0, 0]], 1), branch(1, 0, [0], [[0, 0, 1]], 1)],
    });
    expect(looped?.byId.size).toBe(2);
  });
});

describe("numbers as text", () => {
  it("Values have a true minus sign, and coordinates have side letters.", () => {
    expect(fixed(-600)).toBe("\u2212600");
    expect(fixed(-0.2)).toBe("0");
    expect(coordinates([-17.6, 35.3, 12.1])).toBe("R\u202f17.6  P\u202f35.3  S\u202f12.1 mm");
  });

  it("parseCoordinates accepts three numbers with commas, semicolons or spaces, and returns null for other text.", () => {
    expect(parseCoordinates(" -17.6, 35.3,12.1 ")).toEqual([-17.6, 35.3, 12.1]);
    expect(parseCoordinates("\u221217.6;35.3 12.1")).toEqual([-17.6, 35.3, 12.1]);
    expect(parseCoordinates("1 2")).toBeNull();
    expect(parseCoordinates("1,2,x")).toBeNull();
    expect(parseCoordinates("")).toBeNull();
  });

  it("parseCoordinates accepts side letters if each axis occurs once and without a sign.", () => {
    expect(parseCoordinates("R 89.3 A 127.0 S 390.6")).toEqual([-89.3, -127, 390.6]);
    expect(parseCoordinates("s 390.6, l89.3; P 0 mm")).toEqual([89.3, 0, 390.6]);
    for (const wrong of [
      "R 89.3 L 1 S 390.6",
      "R 89.3 A 127",
      "R -89.3 A 127 S 390",
      "R 1 A 2 S 3 4",
      "R 1.2.3 A 2 S 3",
    ]) {
      expect(parseCoordinates(wrong), wrong).toBeNull();
    }
  });

  it("timeLeft rounds the remaining time to the accuracy of the estimate.", () => {
    expect(timeLeft(1)).toBe("almost done");
    expect(timeLeft(38)).toBe("about 40 s left");
    expect(timeLeft(170)).toBe("about 3 min left");
  });
});

describe("distances from the origin of a route", () => {
  const ridge = { ...ROUTE, origin: { kind: "ridge", along_mm: 31.4 } } as const;
  /** The centrelines are 2 mm longer than the smoothed route up to the fork at 30 mm. */
  const longer = { ...ridge, centreline_mm: [0, 10.5, 32, 42] };

  it("placeText, sideText and pastMm count from the main carina, and from the start of a route without one.", () => {
    expect(pastMm(ridge, 40)).toBeCloseTo(8.6, 9);
    expect(placeText(ridge, 40)).toBe("9\u202fmm past the main carina");
    expect(placeText(ridge, 31.2)).toBe("at the main carina");
    expect(placeText(ridge, 0)).toBe("31\u202fmm above the main carina");
    expect(placeText(ROUTE, 12.4)).toBe("12\u202fmm from the start of the airway tree");
    expect(originText({ ...ROUTE, lumen_known: false })).toBe("the start of the route");
    const searched = { ...ROUTE, origin: { kind: "route", along_mm: 0 }, lumen_known: true } as const;
    expect(placeText(searched, 12)).toBe("12\u202fmm from the start of the route");
    expect(sideText(searched, 12)).toBe("from start");
    expect([sideText(ridge, 40), sideText(ridge, 0), sideText(ROUTE, 0)]).toEqual([
      "past carina",
      "above carina",
      "from start",
    ]);
  });

  it("scaleMm returns multiples of the step from the origin on both sides, without one under the end's flag.", () => {
    expect(scaleMm(ridge, 40, 5)).toEqual([-30, -25, -20, -15, -10, -5, 0, 5]);
    expect(scaleMm(ROUTE, 40, 10)).toEqual([0, 10, 20, 30]);
  });

  it("pastMm measures along the centrelines, and pathAtMm is its inverse.", () => {
    expect(pastMm(longer, 30)).toBeCloseTo(0.6, 9);
    expect(pastMm(longer, 20)).toBeCloseTo(21.25 - 31.4, 9);
    for (const at of [0, 4, 17, 30, 38.5, 40]) expect(pathAtMm(longer, pastMm(longer, at))).toBeCloseTo(at, 9);
    expect(pastMm({ ...ROUTE, centreline_mm: [] }, 12)).toBe(12);
  });
});
