/**
 * Sentences of the window and the phone's page, from the syntax trees of web/src; called by tools/collect_words.py.
 * Prints JSON: {file: [text, ...]} in the order of each file. What stands in braces is filled in while it runs.
 */
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { pathToFileURL } from "node:url";

const [, , webFolder, ...files] = process.argv;
const vite = createRequire(`${webFolder}/package.json`).resolve("vite");
const { parseSync } = await import(pathToFileURL(vite).href);

/** Attributes and fields whose strings a person reads, also where they are one word. */
const READ =
  /^(aria-?label|aria-?description|aria-?valuetext|title|label|labels|placeholder|alt|words|hint|short|text|message|describe|description|question|yes|no|sentence|unit|heading|help|caption|note|why|sign|what|says|figure|summary)$/i;
/** Those whose strings are for programs. */
const UNREAD =
  /^(class(Name)?|d|viewBox|key|id|htmlFor|testId|data-.*|kind|icon|role|type|href|src|rel|target|slot|placement|style|fill|stroke|transform|points|name|lang|accept|autoComplete|inputMode|action|command|axis|place|group|code|font|scope|aria-(live|hidden|controls|labelledby|describedby|current|pressed|orientation|haspopup|modal|atomic))$/;
/** Calls whose arguments are for programs or for who develops. */
const UNREAD_CALLS = /^(querySelector(All)?|matchMedia|getContext|addEventListener|removeEventListener|getElementById|createElement|fetch|startsWith|endsWith|includes|join|split|RegExp|closest|setAttribute|warn|debug|info|log)$/;

const LETTER = "A-Za-z\\u00c0-\\u024f";
const PROSE = new RegExp(`[${LETTER})}][,.;:]? +[(\u201c"{]?[${LETTER}]`);
/** A word beside something that is filled in, such as "{time} left". */
const WORD_BESIDE = /\}[ ,;:%]* [a-z]{3,}\b|(^|\s)[a-z]{3,}[,:;]? \{/;

function isProse(text) {
  const bare = text.replace(/\{[^}]*\}/g, "{x}");
  return WORD_BESIDE.test(bare) || (PROSE.test(bare) && /[a-z]{2}/.test(bare.replaceAll("{x}", "")));
}
const hasLetters = (text) => /[A-Za-z]{2}|\b[aAI]\b/.test(text.replace(/\{[^}]*\}/g, ""));

function nameOf(node) {
  switch (node.type) {
    case "Identifier":
      return node.name;
    case "MemberExpression":
      return nameOf(node.property);
    case "CallExpression":
      return nameOf(node.arguments[0] ?? node.callee);
    case "Literal":
      return String(node.value);
    default:
      return "\u2026";
  }
}

const inBraces = (node) => `{${nameOf(node)}}`;

function textOfTemplate(node) {
  return node.quasis.map((quasi, index) => {
    const between = node.expressions[index];
    return (quasi.value.cooked ?? "") + (between === undefined ? "" : inBraces(between));
  }).join("");
}

function textOfChildren(children) {
  return children
    .map((child) => {
      switch (child.type) {
        case "JSXText":
          return child.value.replace(/\s+/g, " ");
        case "JSXExpressionContainer":
          return child.expression.type === "Literal" ? String(child.expression.value)
            : child.expression.type === "JSXEmptyExpression" ? ""
            : inBraces(child.expression);
        default:
          return "<>";
      }
    })
    .join("");
}

function collect(tree) {
  const found = [];
  const keep = (node, text) => {
    const tidy = text.replace(/\s+/g, " ").trim();
    if (tidy !== "") found.push([node.start, tidy]);
  };
  /** `read`: true where every string is read, false where only prose is, null where none is. */
  function walk(node, read) {
    if (node === null || typeof node !== "object") return;
    if (Array.isArray(node)) {
      for (const child of node) walk(child, read);
      return;
    }
    switch (node.type) {
      case "ImportDeclaration":
      case "ExportAllDeclaration":
      case "TSTypeAliasDeclaration":
      case "TSInterfaceDeclaration":
      case "TSTypeAnnotation":
      case "TSTypeParameterInstantiation":
      case "TSTypeParameterDeclaration":
        return;
      case "ThrowStatement":
        return;
      case "Literal":
        if (typeof node.value === "string" && read !== null && (read ? hasLetters(node.value) : isProse(node.value)))
          keep(node, node.value);
        return;
      case "TemplateLiteral": {
        const text = textOfTemplate(node);
        if (read !== null && (read ? hasLetters(text) : isProse(text))) keep(node, text);
        walk(node.expressions, read === null ? null : false);
        return;
      }
      case "TaggedTemplateExpression":
        return;
      case "BinaryExpression":
        if (/^[=!]==?$/.test(node.operator)) {
          walk(node.left, null);
          walk(node.right, null);
          return;
        }
        break;
      case "SwitchCase":
        walk(node.consequent, read);
        return;
      case "ConditionalExpression":
        walk(node.test, null);
        walk(node.consequent, read);
        walk(node.alternate, read);
        return;
      case "LogicalExpression":
        walk(node.left, read === null ? null : node.operator === "&&" ? null : read);
        walk(node.right, read);
        return;
      case "CallExpression":
      case "NewExpression": {
        walk(node.callee, null);
        const callee = nameOf(node.callee);
        walk(node.arguments, UNREAD_CALLS.test(callee) ? null : read === null ? null : false);
        return;
      }
      case "ArrowFunctionExpression":
      case "FunctionExpression":
      case "FunctionDeclaration":
        walk(node.params, null);
        walk(node.body, node.body?.type === "BlockStatement" ? false : read === true ? true : false);
        return;
      case "Property":
      case "PropertyDefinition": {
        const name = node.key.name ?? node.key.value ?? "";
        walk(node.value, READ.test(name) ? true : UNREAD.test(name) ? null : read === null ? null : false);
        return;
      }
      case "VariableDeclarator": {
        const table = /WORDS|LABELS|NAMES|TITLES|TEXT|GROUPS|HEADINGS|MESSAGES/.test(node.id.name ?? "");
        walk(node.init, table ? "table" : read);
        return;
      }
      case "JSXElement":
      case "JSXFragment": {
        walk(node.openingElement?.attributes ?? [], false);
        const text = textOfChildren(node.children);
        if (node.children.some((child) => child.type === "JSXText" && hasLetters(child.value))) keep(node, text);
        for (const child of node.children) {
          if (child.type === "JSXExpressionContainer") walk(child.expression, true);
          else if (child.type !== "JSXText") walk(child, false);
        }
        return;
      }
      case "JSXAttribute": {
        const name = node.name.name ?? "";
        walk(node.value, READ.test(name) ? true : UNREAD.test(name) || /^on[A-Z]/.test(name) ? (/^on[A-Z]/.test(name) ? false : null) : false);
        return;
      }
      case "JSXExpressionContainer":
        walk(node.expression, read);
        return;
    }
    for (const [name, child] of Object.entries(node)) {
      if (name !== "type" && name !== "start" && name !== "end" && name !== "typeAnnotation") walk(child, read);
    }
  }
  walk(tree.body, false);
  return found.sort((a, b) => a[0] - b[0]).map(([, text]) => text);
}

const all = {};
for (const file of files) {
  const parsed = parseSync(file, readFileSync(file, "utf8"));
  if (parsed.errors.length > 0) throw new Error(`${file}: ${parsed.errors[0].message}`);
  all[file] = collect(parsed.program);
}
process.stdout.write(JSON.stringify(all));
