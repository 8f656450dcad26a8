import { describe, expect, it } from "vitest";
import type { BranchMeasures, TreeBranch } from "../wire/messages";
import { type BranchTree, buildTree, type TreeExtras } from "./airways";
import { bridgeWords, factsOf, filterTree, marksOf, nameWords, tooltipOf } from "./branch-words";

function branch(id: number, parent: number | null, children: number[], change: Partial<TreeBranch> = {}): TreeBranch {
  return {
    id,
    parent,
    children,
    generation: parent === null ? 0 : 1,
    name: null,
    kind: "tracked",
    points: [
      [0, 0, 0],
      [0, 0, -30],
    ],
    radius: [3, 3],
    cost: null,
    confidence: 0.9,
    name_confidence: null,
    name_from: null,
    variant: null,
    ...change,
  };
}

const MEASURES: BranchMeasures = {
  branch_id: 1,
  length_mm: 29.4,
  lumen_mm: 6.12,
  lumen_error_mm: 0.21,
  min_lumen_mm: 4.05,
  min_lumen_error_mm: null,
  min_at_mm: 12.2,
  max_lumen_mm: null,
  max_lumen_error_mm: null,
  wall_mm: 1.1,
  wall_error_mm: 0.3,
  taper: -0.034,
  angle_deg: 41.6,
  stenosis_percent: 33,
  stenosis_error_percent: 5,
  stenosis_at_mm: 12.2,
};

function made(extras: TreeExtras = {}): BranchTree {
  const tree = buildTree(
    {
      format: "carina-tree",
      version: 1,
      space: "LPS",
      unit: "mm",
      root: 0,
      branches: [
        branch(0, null, [1, 2], { name: "Trachea", name_from: "anatomy", name_confidence: 1 }),
        branch(1, 0, [3], {
          name: "RB1",
          name_from: "anatomy",
          name_confidence: 0.42,
          variant: "RB1 and RB2 share a stem",
        }),
        branch(2, 0, [], { name: "My branch", name_from: "person", confidence: 0.3 }),
        branch(3, 1, [], { kind: "bridge", generation: 2 }),
      ],
    },
    extras,
  );
  if (tree === null) throw new Error("no tree");
  return tree;
}

const node = (tree: BranchTree, id: number) => {
  const found = tree.byId.get(id);
  if (found === undefined) throw new Error(`no branch ${id}`);
  return found;
};
const NBSP = "\u202f";

describe("a branch in words", () => {
  const tree = made({ titles: [{ branch_id: 1, long: "apical segment, RUL", lobe: "RUL" }], measures: [MEASURES] });

  it("is marked where its name or itself is doubtful, and where the anatomy is uncommon", () => {
    expect(marksOf(node(tree, 0))).toEqual([]);
    expect(marksOf(node(tree, 1)).map((mark) => mark.sign)).toEqual(["?", "v"]);
    expect(marksOf(node(tree, 2)).map((mark) => mark.sign)).toEqual(["~"]);
  });

  it("says where its name comes from", () => {
    expect(nameWords(node(tree, 1))).toBe("named by its anatomy, 42 % sure");
    expect(nameWords(node(tree, 2))).toBe("named by a person");
    expect(nameWords(node(tree, 3))).toBeNull();
  });

  it("has its long name, figures and doubts in the tooltip", () => {
    expect(tooltipOf(node(tree, 1))).toBe(
      `RB1, apical segment, RUL\ngeneration 1, 30${NBSP}mm long, lumen 6.1${NBSP}mm\n` +
        "the name is only 42 % sure\nuncommon anatomy: RB1 and RB2 share a stem",
    );
    expect(tooltipOf(node(tree, 3))).toContain("a bridge: no airway that the CT shows");
  });

  it("has its figures with their errors, and leaves out what was not measured", () => {
    const facts = new Map(factsOf(node(tree, 1)).map((fact) => [fact.term, fact]));
    expect(facts.get("Lumen")?.value).toBe(`6.1 \u00b1 0.2${NBSP}mm`);
    expect(facts.get("Narrowest")?.value).toBe(`4.0${NBSP}mm at 12${NBSP}mm`);
    expect(facts.has("Widest")).toBe(false);
    expect(facts.get("Taper")?.value).toBe("\u22123.4 mm per 100 mm");
    expect(facts.get("Narrowing")).toMatchObject({ value: `33 % \u00b1 5 at 12${NBSP}mm`, warns: true });
    expect(factsOf(node(tree, 2)).map((fact) => fact.term)).toEqual(["Generation", "Length", "Lumen"]);
  });
});

describe("the search", () => {
  const tree = made({ titles: [{ branch_id: 1, long: "apical segment, RUL", lobe: "RUL" }] });
  const hits = (text: string) => filterTree(tree, text)?.hits;

  it("finds names, long names, lobes, generations, doubts and bridges, with what leads there", () => {
    expect(filterTree(tree, "  ")).toBeNull();
    expect(hits("rb1")).toEqual([1]);
    expect(hits("apical")).toEqual([1]);
    expect(hits("g2")).toEqual([3]);
    expect(hits("?")).toEqual([1, 2]);
    expect(hits("bridge")).toEqual([3]);
    expect([...(filterTree(tree, "bridge")?.shown ?? [])].sort()).toEqual([0, 1, 3]);
    expect(hits("nothing of the kind")).toEqual([]);
  });
});

describe("a route over a bridge", () => {
  it("says so, how long and where", () => {
    const spans = [
      { branch_id: 1, from_mm: 0, to_mm: 30 },
      { branch_id: 3, from_mm: 30, to_mm: 38.5 },
    ];
    expect(bridgeWords(made(), spans)).toBe(
      `8.5${NBSP}mm of this route is a bridge over a blockage, from 30${NBSP}mm: no airway that the CT shows`,
    );
    expect(bridgeWords(made(), spans.slice(0, 1))).toBeNull();
  });
});
