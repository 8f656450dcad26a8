import { readFileSync } from "node:fs";
import { fileURLToPath } from "node:url";
import { describe, expect, it } from "vitest";
import { KEYMAP, MOUSE } from "./key-table";
import { keySections } from "./keymap";

const REPOSITORY = fileURLToPath(new URL("../../../", import.meta.url));

function guide(): string {
  const rows = (pairs: readonly (readonly [string, string])[]) => pairs.map(([key, words]) => `| ${key} | ${words} |`);
  const code = (label: string) => `\`${label}\``;
  const part = (title: string, lines: readonly string[]) => [`## ${title}`, "", "| | |", "|---|---|", ...lines, ""];
  return [
    "# Keys and mouse",
    "",
    "This page is generated from the table of keys (`web/src/input/key-table.ts`): run `npx vitest run -u src/input/key-guide.test.ts` in `web/`. The key `?` shows",
    "the same list. The keys of a view work while that view has the focus; a click or Tab gives it the focus. On a Mac, press Cmd instead of Ctrl.",
    "",
    ...keySections().flatMap(({ title, rows: keys }) =>
      part(title, rows(keys.map((row) => [code(row.label), row.words]))),
    ),
    ...MOUSE.flatMap(({ where, what }) => part(`Mouse: ${where}`, rows(what))),
  ]
    .join("\n")
    .trimEnd()
    .concat("\n");
}

describe("keys in the documentation", () => {
  it("docs/keys.md equals the table of keys.", async () => {
    await expect(guide()).toMatchFileSnapshot(`${REPOSITORY}docs/keys.md`);
  });

  it.each([
    ["README.md", /\b(W|S|Space|M|\?) (?:and S move|move|flies to the next fork|leaves and enters|shows all)/g],
    ["docs/devices.md", /\((?:key |mouse lock \()?`([^`]{1,12})`\)/g],
    ["docs/key-frames.md", /`([.,]|Ctrl\+Z)`/g],
  ])("Every key that %s names is a key of the table.", (file, pattern) => {
    const labels = new Set(KEYMAP.map((binding) => binding.label));
    const named = [...readFileSync(`${REPOSITORY}${file}`, "utf8").matchAll(pattern)].map((found) => found[1]);
    expect(named.length).toBeGreaterThan(1);
    expect(named.filter((label) => label !== undefined && !labels.has(label))).toEqual([]);
  });
});
