/** Tests of the accessible names of buttons. */

import { describe, expect, it } from "vitest";
import { buttonName } from "./controls";

describe("buttonName", () => {
  it("A description that contains the visible word is the name, in upper or lower case.", () => {
    expect(buttonName("Route line", "Route line")).toBe("Route line");
    expect(buttonName("Show the route line", "Route line")).toBe("Show the route line");
  });

  it("The visible word precedes a description that contains it only as a part of another word, or not at all.", () => {
    expect(buttonName("Octagonal image, as through this scope", "Octagon")).toBe(
      "Octagon: Octagonal image, as through this scope",
    );
    expect(buttonName("Show the tri-plane here", "Switch")).toBe("Switch: Show the tri-plane here");
  });

  it("A button without a visible word has its description as its name.", () => {
    expect(buttonName("Level the horizon", undefined)).toBe("Level the horizon");
  });
});
