import { describe, expect, it } from "vitest";
import type { BranchNode } from "../state/airways";
import type { SeenGeometry } from "../state/projection";
import { type Ink, NamePlaces } from "./ink";
import { paintNames } from "./overlay-names";
import type { Scene } from "./scene";
import type { Viewport } from "./viewport";

/** Return a fake canvas with ten pixels per letter, which records the texts and their positions. */
function inkOf(written: { text: string; x: number }[]): Ink {
  const fill = (text: string, x: number) => written.push({ text, x });
  return new Proxy({} as Ink, {
    get: (_, key) => {
      if (key === "measureText") return (text: string) => ({ width: 10 * text.length });
      return key === "fillText" ? fill : () => undefined;
    },
    set: () => true,
  });
}

const SIZE = { width: 400, height: 400 };
const viewport = {
  size: SIZE,
  screenAt: (at: { column: number; row: number }) => ({ x: at.column, y: at.row }),
} as unknown as Viewport;

/** A front view with one pixel per mm at a distance of 1000 mm; the patient's left is on the right. */
const geometry: SeenGeometry = {
  kind: "seen",
  camera: { position: [200, -1000, 200], right: [1, 0, 0], down: [0, 0, -1], forward: [0, 1, 0] },
  focalPx: 1000,
  lens: null,
  ...SIZE,
};

const node = (label: string, x: number, z: number, diameterMm: number) =>
  ({ label, diameterMm, branch: { points: [[x, 0, z]] } }) as unknown as BranchNode;

const paint = (titled: BranchNode[]) => {
  const written: { text: string; x: number }[] = [];
  const scene = { titled, trunkEnd: [200, 0, 250] } as unknown as Scene;
  paintNames(inkOf(written), viewport, geometry, scene, new NamePlaces());
  return written;
};

describe("names on the tree", () => {
  it("A name is on its own side of the trachea, or left out if it does not fit there.", () => {
    const written = paint([node("LLL", 230, 180, 8), node("RLL", 170, 180, 7), node("left basal trunk", 290, 120, 6)]);
    const at = Object.fromEntries(written.map(({ text, x }) => [text, x]));
    expect(at["LLL"]).toBeGreaterThan(230);
    expect(at["RLL"]).toBeLessThan(170);
    // Sixteen letters do not fit to the right, and no name may cover the right lung.
    expect(at["left basal trunk"]).toBeUndefined();
  });

  it("A bronchus in several pieces is named once.", () => {
    const written = paint([node("RLL", 170, 220, 8), node("RLL", 160, 120, 7)]);
    expect(written.filter(({ text }) => text === "RLL")).toHaveLength(1);
  });
});
