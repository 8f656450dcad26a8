import { describe, expect, test } from "vitest";
import { INITIAL_STATE } from "../state/app-state";
import { Painting } from "./painting";
import { type Scene, sceneOf } from "./scene";

const drawn = (scene: Scene, ...parts: (keyof Scene)[]) => {
  const painting = new Painting({ version: 1 });
  const watched = painting.watched(scene);
  for (const part of parts) void watched[part];
  return painting;
};
const withUi = (change: Partial<typeof INITIAL_STATE.ui>) => ({
  ...INITIAL_STATE,
  ui: { ...INITIAL_STATE.ui, ...change },
});

describe("repaint of an overlay", () => {
  test("A painting stays valid while the picture's version and the values that it has read are unchanged.", () => {
    const scene = sceneOf(INITIAL_STATE);
    const painting = drawn(scene, "tip", "routeLineVisible");
    expect(painting.holds({ version: 1 }, scene)).toBe(true);
    expect(painting.holds({ version: 1 }, { ...scene, outlineVisible: !scene.outlineVisible })).toBe(true);
    expect(painting.holds({ version: 1 }, { ...scene, routeLineVisible: !scene.routeLineVisible })).toBe(false);
    expect(painting.holds({ version: 2 }, scene)).toBe(false);
  });

  test("Parts of two scenes with equal contents are the same objects.", () => {
    const brush = withUi({ armed: "paint", brushMm: 3 });
    const first = sceneOf(brush);
    const again = sceneOf({ ...brush });
    expect(again.brush).toBe(first.brush);
    expect(again.targets).toBe(first.targets);
    const wider = sceneOf(withUi({ armed: "paint", brushMm: 4 }));
    expect(wider.brush).toEqual({ radiusMm: 4, erase: false });
    expect(drawn(first, "brush").holds({ version: 1 }, again)).toBe(true);
    expect(drawn(first, "brush").holds({ version: 1 }, wider)).toBe(false);
  });
});
