import { describe, expect, it } from "vitest";
import { clockHour, edgeLetters, lettersOf, ringMarks } from "./letters";
import { randomAxes, randomOf } from "./rotations.testing";
import { dot, type Vec3 } from "./vec";

const opposite: Record<string, string> = { R: "L", L: "R", A: "P", P: "A", S: "I", I: "S" };
const mirrored = (text: string) => [...text].map((letter) => opposite[letter]).join("");

describe("lettersOf and edgeLetters", () => {
  it("The six patient axes have the letters L, R, P, A, S and I.", () => {
    expect(lettersOf([1, 0, 0])).toBe("L");
    expect(lettersOf([-1, 0, 0])).toBe("R");
    expect(lettersOf([0, 1, 0])).toBe("P");
    expect(lettersOf([0, -1, 0])).toBe("A");
    expect(lettersOf([0, 0, 1])).toBe("S");
    expect(lettersOf([0, 0, -1])).toBe("I");
  });

  it("The dominant direction comes first, and a tilt of 5 degrees adds no letter.", () => {
    expect(lettersOf([0.5, -0.8, 0])).toBe("AL");
    // A tilt of 5 degrees adds no letter; a tilt of 20 degrees does.
    expect(lettersOf([Math.sin(0.087), 0, Math.cos(0.087)])).toBe("S");
    expect(lettersOf([Math.sin(0.35), 0, Math.cos(0.35)])).toBe("SL");
  });

  it("Opposite edges have opposite letters for any rotation.", () => {
    const random = randomOf(1);
    for (let round = 0; round < 500; round += 1) {
      const { right, down } = randomAxes(random);
      const letters = edgeLetters(right, down);
      expect(letters.left).toBe(mirrored(letters.right));
      expect(letters.top).toBe(mirrored(letters.bottom));
    }
  });

  it("The letters do not depend on the length of the direction.", () => {
    const random = randomOf(2);
    for (let round = 0; round < 200; round += 1) {
      const { right } = randomAxes(random);
      expect(lettersOf([right[0] * 0.03, right[1] * 0.03, right[2] * 0.03])).toBe(lettersOf(right));
    }
  });

  it("An axial slice has the patient's right at the left edge, as in radiology.", () => {
    expect(edgeLetters([1, 0, 0], [0, 1, 0])).toEqual({ left: "R", right: "L", top: "A", bottom: "P" });
  });
});

describe("ringMarks", () => {
  it("The patient's right is on the right for a camera that looks from the head with anterior up.", () => {
    // The camera looks inferior with anterior up: right = forward x up = patient right (reference: features, section 4).
    const marks = ringMarks({ right: [-1, 0, 0], down: [0, 1, 0] });
    const angle = (text: string) => marks.find((mark) => mark.text === text)?.angleRad;
    expect(angle("A")).toBeCloseTo(0);
    expect(angle("R")).toBeCloseTo(Math.PI / 2);
    expect(Math.abs(angle("P") ?? 0)).toBeCloseTo(Math.PI);
    expect(angle("L")).toBeCloseTo(-Math.PI / 2);
    expect(marks).toHaveLength(4);
  });

  it("A clockwise roll of the camera turns the letters counterclockwise by the same angle.", () => {
    const roll = 0.6;
    const right: Vec3 = [-Math.cos(roll), Math.sin(roll), 0];
    const down: Vec3 = [Math.sin(roll), Math.cos(roll), 0];
    expect(dot(right, down)).toBeCloseTo(0);
    const anterior = ringMarks({ right, down }).find((mark) => mark.text === "A");
    expect(anterior?.angleRad).toBeCloseTo(-roll);
  });

  it("Opposite letters are at opposite angles for any rotation.", () => {
    const random = randomOf(3);
    for (let round = 0; round < 500; round += 1) {
      const marks = ringMarks(randomAxes(random));
      expect(marks.length).toBeGreaterThanOrEqual(2);
      for (const mark of marks) {
        const partner = marks.find((other) => other.text === mirrored(mark.text));
        expect(partner, `${mark.text} has no partner`).toBeDefined();
        const turned = Math.abs(mark.angleRad - (partner?.angleRad ?? 0));
        expect(turned).toBeCloseTo(Math.PI, 5);
      }
    }
  });

  it("The picture direction of a letter corresponds to its patient direction for any rotation.", () => {
    const random = randomOf(4);
    for (let round = 0; round < 300; round += 1) {
      const { right, down } = randomAxes(random);
      for (const mark of ringMarks({ right, down })) {
        const x = Math.sin(mark.angleRad);
        const y = -Math.cos(mark.angleRad);
        const towards: Vec3 = [x * right[0] + y * down[0], x * right[1] + y * down[1], x * right[2] + y * down[2]];
        const axis = { R: 0, L: 0, A: 1, P: 1, S: 2, I: 2 }[mark.text[0] as "R"];
        const sign = { R: -1, L: 1, A: -1, P: 1, S: 1, I: -1 }[mark.text[0] as "R"];
        // The ring shows directions at least 30 degrees off the viewing axis: sin 30 = 0.5.
        expect((towards[axis] ?? 0) * sign).toBeGreaterThan(0.49);
      }
    }
  });

  it("Two directions that coincide in the picture share one mark.", () => {
    // With a view half down and half back, anterior and superior coincide at the top.
    const half = Math.SQRT1_2;
    const marks = ringMarks({ right: [-1, 0, 0], down: [0, half, -half] });
    expect(marks.map((mark) => mark.text).sort()).toEqual(["AS", "L", "PI", "R"]);
  });
});

describe("clockHour", () => {
  it("Hours are counted clockwise from 12 at the top.", () => {
    expect(clockHour(0)).toBe(12);
    expect(clockHour(Math.PI / 2)).toBe(3);
    expect(clockHour(Math.PI)).toBe(6);
    expect(clockHour(-Math.PI / 2)).toBe(9);
    expect(clockHour(-0.1)).toBe(12);
  });
});
