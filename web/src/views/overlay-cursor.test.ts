import { describe, expect, it } from "vitest";
import { notePlace, placedNote, wrapped } from "./overlay-cursor";

describe("text at the cursor", () => {
  it("Text is broken between words into lines that fit, and a word that is too long has its own line.", () => {
    const fits = (line: string) => line.length <= 9;
    expect(wrapped("RB4 becomes RML", fits)).toEqual(["RB4", "becomes", "RML"]);
    expect(wrapped("the end of it", fits)).toEqual(["the end", "of it"]);
    expect(wrapped("a bronchioloalveolar one", fits)).toEqual(["a", "bronchioloalveolar", "one"]);
    expect(wrapped("", fits)).toEqual([""]);
  });
});

/** Size of a narrow slice in a window of 1280 x 720 px, with the indicator of the active tool in its corner. */
const SLICE = { width: 192, height: 154 };
const TAG = { x: 130, y: 6, width: 56, height: 22 };

const overlaps = (one: typeof TAG, other: typeof TAG) =>
  one.x < other.x + other.width &&
  other.x < one.x + one.width &&
  one.y < other.y + other.height &&
  other.y < one.y + one.height;

describe("place of the text at the cursor", () => {
  it("The text is beside the cursor, inside the view, and never below the indicator of the active tool.", () => {
    for (const [width, height] of [
      [60, 22],
      [170, 37],
      [184, 112],
    ] as const) {
      for (let x = 0; x <= SLICE.width; x += 6) {
        for (let y = 0; y <= SLICE.height; y += 6) {
          const box = notePlace({ x, y }, { width, height }, SLICE, [TAG]);
          if (box === null) throw new Error(`no place at ${x}, ${y}`);
          expect(overlaps(box, TAG)).toBe(false);
          expect(box.x).toBeGreaterThanOrEqual(0);
          expect(box.y).toBeGreaterThanOrEqual(0);
          expect(box.x + width).toBeLessThanOrEqual(SLICE.width);
          expect(box.y + height).toBeLessThanOrEqual(SLICE.height);
        }
      }
    }
    expect(notePlace({ x: 40, y: 40 }, { width: 60, height: 22 }, SLICE, [TAG])).toMatchObject({ x: 56, y: 52 });
  });

  it("In a narrow slice the origin of a new branch is uncovered, and renamed branches without space are left out.", () => {
    const texts = [
      "new branch from Right basal trunk, 41 mm",
      ...[1, 2, 3, 4].map((n) => `RB${n}+5 becomes Branch 5${n}`),
    ];
    const measure = {
      fits: (line: string) => line.length <= 28,
      sizeOf: (lines: readonly string[]) => ({
        width: 6 * Math.max(...lines.map((line) => line.length)) + 12,
        height: 15 * lines.length + 7,
      }),
    };
    const all = placedNote(texts, { x: 100, y: 80 }, SLICE, [TAG], measure);
    expect(all.lines).toHaveLength(6);
    const low = { width: 192, height: 120 };
    const some = placedNote(texts, { x: 100, y: 60 }, low, [TAG], measure);
    expect(some.lines.slice(0, 2)).toEqual(["new branch from Right basal", "trunk, 41 mm"]);
    expect(some.lines.at(-1)).toBe("and more");
    expect(overlaps(some.box, TAG)).toBe(false);
    expect(some.box.y + some.box.height).toBeLessThanOrEqual(low.height);
  });
});
