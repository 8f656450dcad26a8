import { describe, expect, it } from "vitest";
import type { BranchMeasures, RouteSpan, TreeBranch, TreeDocument } from "../wire/messages";
import { type BranchTree, buildTree, headOf, rowChildren, type TreeExtras } from "./airways";
import {
  bestHit,
  calibreOf,
  drawnShare,
  drawnText,
  factsOf,
  filterTree,
  marksOf,
  marksOfRow,
  nameText,
  routeDoubts,
  rowLengthMm,
  tooltipOf,
} from "./branch-text";
import { testBranch } from "./branches.testing";

function branch(id: number, parent: number | null, children: number[], change: Partial<TreeBranch> = {}): TreeBranch {
  return testBranch(id, parent, children, { confidence: 0.9, ...change });
}

const MEASURES: BranchMeasures = {
  branch_id: 1,
  length_mm: 29.4,
  by_earlier_method: false,
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

describe("bronchus that a side branch divides", () => {
  const name = { name: "RB6", name_from: "anatomy", name_confidence: 0.9 } as const;
  const given = (change: Partial<TreeBranch> = {}): BranchTree => {
    const document: TreeDocument = {
      format: "carina-tree",
      version: 1,
      space: "LPS",
      unit: "mm",
      root: 0,
      branches: [
        branch(0, null, [1, 2], { name: "RLL", name_from: "anatomy", name_confidence: 1 }),
        branch(1, 0, [3, 4], { ...name, radius: [2, 2] }),
        branch(2, 0, []),
        branch(3, 1, [5], { ...name, radius: [1.5, 1.5], name_confidence: 0.55, generation: 2, ...change }),
        branch(4, 1, [], { generation: 2 }),
        branch(5, 3, [], { generation: 3 }),
      ],
    };
    const tree = buildTree(document, {
      measures: [
        { ...MEASURES, branch_id: 1, lumen_mm: 4 },
        { ...MEASURES, branch_id: 3, lumen_mm: 3 },
      ],
    });
    if (tree === null) throw new Error("no tree");
    return tree;
  };

  it("Its branches form one row with the total length and the range of diameters.", () => {
    const tree = given();
    const head = node(tree, 1);
    expect(head.row.map((piece) => piece.branch.id)).toEqual([1, 3]);
    expect(headOf(node(tree, 3))).toBe(head);
    expect(rowChildren(head).map((child) => child.branch.id)).toEqual([4, 5]);
    expect(rowLengthMm(head)).toBe(60);
    expect(calibreOf(head)).toBe("3.0\u20134.0");
    expect(tooltipOf(head)).toContain("2 pieces between side branches");
    expect(marksOfRow(head).map((mark) => mark.sign)).toEqual(["?"]);
    expect(filterTree(tree, "RB6")?.hits).toEqual([1]);
    expect(factsOf(node(tree, 3)).map((fact) => fact.term)).toContain("All pieces");
  });

  it("A branch with another name, a user's name or another kind begins a separate row.", () => {
    for (const change of [{ name_from: "person" }, { kind: "bridge" }, { name: "RB7" }] as const) {
      expect(node(given(change), 1).row.map((piece) => piece.branch.id)).toEqual([1]);
    }
  });
});

describe("texts about a branch", () => {
  const tree = made({ titles: [{ branch_id: 1, long: "apical segment, RUL", lobe: "RUL" }], measures: [MEASURES] });

  it("A branch is marked for a doubtful name, a doubtful airway and an anatomical variant.", () => {
    expect(marksOf(node(tree, 0))).toEqual([]);
    expect(marksOf(node(tree, 1)).map((mark) => mark.sign)).toEqual(["?", "v"]);
    expect(marksOf(node(tree, 2)).map((mark) => mark.sign)).toEqual(["~"]);
  });

  it("nameText states the source and the confidence of the name.", () => {
    expect(nameText(node(tree, 1))).toBe("automatic name, 42 % confidence");
    expect(nameText(node(tree, 2))).toBe("named by hand");
    expect(nameText(node(tree, 3))).toBeNull();
  });

  it("The tooltip contains the long name, the measurements and the doubts.", () => {
    expect(tooltipOf(node(tree, 1))).toBe(
      `RB1, apical segment, RUL\ngeneration 1, 30${NBSP}mm long, lumen 6.1${NBSP}mm\n` +
        "only 42 % confidence in this name\nuncommon anatomy: RB1 and RB2 share a stem",
    );
    expect(tooltipOf(node(tree, 3))).toContain("Bridge across an obstruction. The CT shows no airway here.");
  });

  it("Measurements are listed with their errors, and missing measurements are left out.", () => {
    const facts = new Map(factsOf(node(tree, 1)).map((fact) => [fact.term, fact]));
    expect(facts.get("Lumen")?.value).toBe(`6.1 \u00b1 0.2${NBSP}mm`);
    expect(facts.get("Narrowest")?.value).toBe(`4.0${NBSP}mm at 12${NBSP}mm`);
    expect(facts.has("Widest")).toBe(false);
    expect(facts.get("Taper")?.value).toBe("\u22123.4 mm per 100 mm");
    expect(facts.get("Narrowing")).toMatchObject({ value: `33 % \u00b1 5 at 12${NBSP}mm`, warns: true });
    expect(factsOf(node(tree, 2)).map((fact) => fact.term)).toEqual(["Generation", "Length", "Lumen"]);
  });

  it("Without a measurement the diameter is not measured yet; an earlier method is stated with a warning.", () => {
    const lumenOf = (made: BranchTree, id: number) => factsOf(node(made, id)).find((fact) => fact.term === "Lumen");
    expect(lumenOf(tree, 2)?.value).toBe("not measured yet");
    expect(calibreOf(node(tree, 2))).toBeNull();
    const old = made({ measures: [{ ...MEASURES, by_earlier_method: true }] });
    expect(factsOf(node(old, 1)).find((fact) => fact.term === "Measured by")).toMatchObject({ warns: true });
    expect(factsOf(node(tree, 1)).some((fact) => fact.term === "Measured by")).toBe(false);
  });

  it("Narrowing is listed whenever the server reports a stenosis.", () => {
    const narrowing = (stenosis_percent: number | null) => {
      const measured = made({ measures: [{ ...MEASURES, stenosis_percent, stenosis_error_percent: 0.3 }] });
      return factsOf(node(measured, 1)).find((fact) => fact.term === "Narrowing")?.value;
    };
    expect(narrowing(null)).toBeUndefined();
    expect(narrowing(0.9)).toContain("1 %");
  });
});

describe("filterTree", () => {
  const tree = made({ titles: [{ branch_id: 1, long: "apical segment, RUL", lobe: "RUL" }] });
  const hits = (text: string) => filterTree(tree, text)?.hits;

  it("finds names, long names, lobes, generations, doubtful branches and bridges, and shows their ancestors", () => {
    expect(filterTree(tree, "  ")).toBeNull();
    expect(hits("rb1")).toEqual([1]);
    expect(hits("apical")).toEqual([1]);
    expect(hits("g2")).toEqual([3]);
    expect(hits("?")).toEqual([1, 2]);
    expect(hits("bridge")).toEqual([3]);
    expect([...(filterTree(tree, "bridge")?.shown ?? [])].sort()).toEqual([0, 1, 3]);
    expect(hits("nothing of the kind")).toEqual([]);
  });

  it("The best match has exactly the searched name, or is the first in the list.", () => {
    const document: TreeDocument = {
      format: "carina-tree",
      version: 1,
      space: "LPS",
      unit: "mm",
      root: 0,
      branches: [
        branch(0, null, [1, 2]),
        branch(1, 0, [], { name: "RB10", name_from: "anatomy", name_confidence: 0.9 }),
        branch(2, 0, [], { name: "RB1", name_from: "anatomy", name_confidence: 0.9 }),
      ],
    };
    const lungs = buildTree(document);
    if (lungs === null) throw new Error("no tree");
    const best = (text: string) => bestHit(lungs, filterTree(lungs, text) ?? { shown: new Set(), hits: [] }, text);
    expect(filterTree(lungs, "rb1")?.hits).toEqual([1, 2]);
    expect(best(" rb1 ")).toBe(2);
    expect(best("rb")).toBe(1);
    expect(best("LB3")).toBeNull();
  });
});

/** Return a route with these parts that passes the main carina, 20 mm from its start. */
const routeOf = (spans: readonly Pick<RouteSpan, "kind" | "from_mm" | "to_mm">[]) => ({
  spans,
  origin: { kind: "ridge", along_mm: 20 } as const,
  lumen_known: true,
  cumulative_mm: [0, 200],
  centreline_mm: [0, 200],
});

describe("routeDoubts", () => {
  it("The text states the length and the start of a bridge on the route, and is null without a bridge.", () => {
    const spans = [
      { kind: "tracked", from_mm: 0, to_mm: 30 },
      { kind: "bridge", from_mm: 30, to_mm: 38.5 },
    ] as const;
    expect(routeDoubts(routeOf(spans))).toBe(
      `8.5${NBSP}mm of this route is a bridge across an obstruction, starting 10${NBSP}mm past the main carina: the CT shows no airway there.`,
    );
    expect(routeDoubts(routeOf(spans.slice(0, 1)))).toBeNull();
  });
});

describe("branch drawn by hand", () => {
  const measured = { ...MEASURES, branch_id: 4 };
  const tree = buildTree(
    {
      format: "carina-tree",
      version: 1,
      space: "LPS",
      unit: "mm",
      root: 0,
      branches: [
        branch(0, null, [4]),
        // An anatomical name on a hand-drawn branch is invalid and not shown.
        branch(4, 0, [], {
          kind: "manual",
          name: "LB5",
          name_from: "anatomy",
          name_confidence: 0.9,
          confidence: null,
          doubtful_mm: 21.3,
        }),
      ],
    },
    { measures: [measured], titles: [{ branch_id: 4, long: "inferior lingular segment, LUL", lobe: "LUL" }] },
  );
  if (tree === null) throw new Error("no tree");
  const drawn = node(tree, 4);

  it("is labelled as drawn by hand and has no anatomical name, confidence or diameter", () => {
    expect(drawn.label).toBe("Branch 4");
    expect(drawn.longName).toBeNull();
    expect(drawn.lobe).toBeNull();
    expect(nameText(drawn)).toBeNull();
    expect(marksOf(drawn)).toEqual([]);
    expect(drawnText(drawn)).toBe(`Drawn by hand. The CT shows no wall along 21${NBSP}mm of it.`);
    expect(tooltipOf(drawn)).not.toContain("lumen");
    const facts = factsOf(drawn);
    expect(facts.map((fact) => fact.term)).toEqual(["Generation", "Length", "Lumen"]);
    expect(facts[2]?.value).toBe("not measured: drawn by hand");
    expect(filterTree(tree, "by hand")?.hits).toEqual([4]);
  });

  it("keeps a name that the user has given", () => {
    const named = branch(1, 0, [], { kind: "manual", name: "Mine", name_from: "person" });
    const own = buildTree({
      format: "carina-tree",
      version: 1,
      space: "LPS",
      unit: "mm",
      root: 0,
      branches: [branch(0, null, [1]), named],
    });
    expect(own === null ? null : node(own, 1).label).toBe("Mine");
  });

  it("drawnShare states its length and its start on a route.", () => {
    const spans = [
      { kind: "tracked", from_mm: 0, to_mm: 159 },
      { kind: "manual", from_mm: 159, to_mm: 180 },
    ] as const;
    expect(drawnShare(routeOf(spans))).toBe(
      `21 of 180${NBSP}mm drawn by hand, starting 139${NBSP}mm past the main carina`,
    );
    expect(routeDoubts(routeOf(spans.slice(0, 1)))).toBeNull();
  });
});
