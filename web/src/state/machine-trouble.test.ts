import { describe, expect, it } from "vitest";
import type { PictureHeader } from "../wire/messages";
import { INITIAL_STATE } from "./app-state";
import { machineTrouble } from "./machine-trouble";

const LATE = { ...INITIAL_STATE, pace: { fps: 20, ageMs: 30, waitingMs: 900 } };
const viewfinder = { view: "cut-plane", stands_for: "airway" } as PictureHeader;

describe("problem of the machine", () => {
  it("is null while the machine keeps up", () => {
    expect(machineTrouble(INITIAL_STATE)).toBeNull();
    expect(machineTrouble({ ...LATE, pace: { ...LATE.pace, waitingMs: 600 } })).toBeNull();
  });

  it("states a late picture of the airway view, and the viewfinder that replaces the view", () => {
    expect(machineTrouble(LATE)).toBe("updating\u2026");
    expect(machineTrouble({ ...INITIAL_STATE, frames: { airway: viewfinder } })).toBe("viewfinder");
  });

  it("states nothing about an airway view that another view covers", () => {
    const covered = { ...LATE, frames: { airway: viewfinder }, ui: { ...LATE.ui, full: "axial" as const } };
    expect(machineTrouble(covered)).toBeNull();
    expect(machineTrouble({ ...LATE, ui: { ...LATE.ui, full: "airway" as const } })).toBe("updating\u2026");
  });
});
