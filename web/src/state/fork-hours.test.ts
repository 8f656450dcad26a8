import { readFileSync } from "node:fs";
import { fileURLToPath } from "node:url";
import { describe, expect, it } from "vitest";
import type { TreeBranch, TurnOpening } from "../wire/messages";
import { buildTree, onwardBranches } from "./airways";
import { testBranch } from "./branches.testing";
import { cameraFromMatrix } from "./vec";

interface Case {
  name: string;
  lps_from_camera: number[];
  branches: Pick<TreeBranch, "id" | "parent" | "children" | "points" | "radius">[];
  openings: TurnOpening[];
  doubtful: boolean;
  hours: Record<string, number | null>;
}

describe("clock hours of branch openings", () => {
  const file = fileURLToPath(new URL("../../../tests/golden/fork-hours.json", import.meta.url));
  const cases = JSON.parse(readFileSync(file, "utf-8")) as Case[];

  it.each(cases.map((made) => [made.name, made] as const))(
    "They equal the hours in the server's list of turns: %s",
    (_name, made) => {
      const tree = buildTree({
        format: "carina-tree",
        version: 1,
        space: "LPS",
        unit: "mm",
        root: made.branches[0]?.id ?? -1,
        branches: made.branches.map((one) => testBranch(one.id, one.parent, [...one.children], one)),
      });
      if (tree === null) throw new Error("the tree has a root");
      const listed = made.openings.map((opening) => {
        const node = tree.byId.get(opening.branch_id);
        if (node === undefined) throw new Error(`the tree has branch ${opening.branch_id}`);
        return { node, opening };
      });
      const camera = cameraFromMatrix(made.lps_from_camera);
      const ways = onwardBranches(tree.root, camera, null, {
        ways: listed,
        doubtful: made.doubtful,
        atViewpoint: true,
      });
      expect(Object.fromEntries(ways.map((way) => [`${way.node.branch.id}`, way.hour]))).toEqual(made.hours);
    },
  );
});
