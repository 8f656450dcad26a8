import { describe, expect, it } from "vitest";
import { INITIAL_STATE, reduce, type Ui } from "./app-state";

const changed = (...changes: Partial<Ui>[]): Ui =>
  changes.reduce((state, change) => reduce(state, { kind: "ui", change }), INITIAL_STATE).ui;

describe("the panel of a narrow left column", () => {
  it("is the tree in Airways and the panel of the step in the other steps", () => {
    expect(changed({ step: "target" }).panel).toBe("step");
    expect(changed({ step: "target" }, { step: "airways" }).panel).toBe("list");
  });

  it("stays when the same step is chosen again", () => {
    expect(changed({ step: "airways" }, { panel: "step" }, { step: "airways" }).panel).toBe("step");
  });

  it("shows a chosen list, and an opened panel of devices or key frames", () => {
    expect(changed({ step: "route" }, { list: "history" }).panel).toBe("list");
    expect(changed({ devicesOpen: true }).panel).toBe("step");
    expect(changed({ keysOpen: true }).panel).toBe("step");
  });
});
