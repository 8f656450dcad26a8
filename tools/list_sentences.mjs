/**
 * Print the sentences of the window and the phone page, read from the syntax trees of web/src, for tools/check_wording.py.
 * The output is JSON: {file: [text, ...]} in the order of each file. Braces contain values that the program inserts.
 */
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { pathToFileURL } from "node:url";

const [, , webFolder, ...files] = process.argv;
const vite = createRequire(`${webFolder}/package.json`).resolve("vite");
const { parseSync } = await import(pathToFileURL(vite).href);

/** Attributes and fields whose strings users read, single words included. */
const READ =
  /^(aria-?label|aria-?description|aria-?valuetext|title|label|labels|placeholder|alt|words|hint|short|text|message|describe|description|question|yes|no|sentence|unit|heading|help|caption|note|why|sign|what|says|figure|summary)$/i;
/** Attributes and fields whose strings are for programs. */
const UNREAD =
  /^(class(Name)?|d|viewBox|key|id|htmlFor|testId|data-.*|kind|icon|role|type|href|src|rel|target|slot|placement|style|fill|stroke|transform|points|name|lang|accept|autoComplete|inputMode|action|command|axis|place|group|code|font|scope|aria-(live|hidden|controls|labelledby|describedby|current|pressed|orientation|haspopup|modal|atomic))$/;
/** Functions whose arguments are for programs or developers. */
const UNREAD_CALLS = /^(querySelector(All)?|matchMedia|getContext|addEventListener|removeEventListener|getElementById|createElement|fetch|startsWith|endsWith|includes|join|split|RegExp|closest|setAttribute|warn|debug|info|log)$/;

const LETTER = "A-Za-z\\u00c0-\\u024f";
const PROSE = new RegExp(`[${LETTER})}\\]][,.;:]? +[(\u201c"{\\[]?[${LETTER}]`);
/** A word beside an inserted value, such as "{time} left". */
const WORD_BESIDE = /\}[ ,;:%]* [a-z]{3,}\b|(^|\s)[a-z]{3,}[,:;]? \{/;
/** Elements whose text is part of the surrounding sentence. */
const INLINE = /^(a|abbr|b|code|em|i|kbd|mark|q|small|span|strong|sub|sup|var)$/;

function isProse(text) {
  const bare = text.replace(/\{[^}]*\}/g, "{x}");
  return WORD_BESIDE.test(bare) || (PROSE.test(bare) && /[a-z]{2}/.test(bare.replaceAll("{x}", "")));
}
const hasLetters = (text) => /[A-Za-z]{2}|\b[aAI]\b/.test(text.replace(/\{[^}]*\}/g, ""));

/** Return whether a node is an expression in parentheses. */
const isWrapped = (node) => node.type.startsWith("Parenthesi");

function nameOf(node) {
  if (isWrapped(node)) return nameOf(node.expression);
  switch (node.type) {
    case "Identifier":
    case "PrivateIdentifier":
      return node.name;
    case "MemberExpression":
      return node.computed ? nameOf(node.object) : nameOf(node.property);
    case "CallExpression": {
      const first = node.arguments[0];
      const isWritten = first === undefined || first.type === "Literal" || first.type.endsWith("FunctionExpression");
      if (!isWritten) return nameOf(first);
      return nameOf(node.callee.type === "MemberExpression" && first !== undefined ? node.callee.object : node.callee);
    }
    case "Literal":
      return String(node.value);
    case "BinaryExpression":
      return nameOf(node.left.type === "Literal" ? node.right : node.left);
    case "LogicalExpression":
      return nameOf(node.left);
    case "ConditionalExpression":
      return nameOf(node.consequent);
    case "UnaryExpression":
    case "AwaitExpression":
      return nameOf(node.argument);
    case "ChainExpression":
    case "TSNonNullExpression":
    case "TSAsExpression":
      return nameOf(node.expression);
    default:
      return "\u2026";
  }
}

/** Nodes whose text is part of a longer text and is therefore not listed as a sentence. */
const used = new Set();

/** Return the literal text of a node, with inserted values in braces; null for other nodes. */
function writtenText(node) {
  if (isWrapped(node)) return writtenText(node.expression);
  switch (node.type) {
    case "Literal":
      if (typeof node.value !== "string") return node.value === null ? "" : null;
      used.add(node);
      return node.value;
    case "TemplateLiteral":
      used.add(node);
      return textOfTemplate(node);
    case "JSXFragment":
    case "JSXElement": {
      if (node.type === "JSXElement" && !INLINE.test(node.openingElement.name.name ?? "")) return null;
      used.add(node);
      return textOfChildren(node.children).trim();
    }
    case "ConditionalExpression": {
      const texts = choicesOf(node);
      return texts === null ? null : texts.length === 0 ? "" : `[${texts.join(" | ")}]`;
    }
    case "LogicalExpression": {
      if (node.operator !== "&&") return null;
      const text = writtenText(node.right);
      return text === null || text === "" ? text : `[${text}]`;
    }
    default:
      return null;
  }
}

/** Return the alternative texts of a conditional expression; null if no branch is a literal text. */
function choicesOf(node) {
  const found = [];
  let isWritten = false;
  for (const side of [node.consequent, node.alternate]) {
    const texts = side.type === "ConditionalExpression" ? choicesOf(side) : [writtenText(side)];
    if (texts === null || texts[0] === null) {
      const isElement = side.type.startsWith("JSX");
      if (!isElement) found.push(`{${nameOf(side)}}`);
    } else {
      isWritten ||= texts.some((text) => text !== "");
      found.push(...texts);
    }
  }
  return isWritten ? [...new Set(found.filter((text) => text !== ""))] : null;
}

/** Return the text for an expression: {inserted value}, [optional text], [alternative | alternative]. */
function inBraces(node) {
  if (node.type === "CallExpression" && node.callee.name === "plural") {
    const [count, one, many] = node.arguments;
    const words = many === undefined ? `${one.value}[s]` : one.value === many.value ? one.value : `[${one.value} | ${many.value}]`;
    if (typeof one.value === "string") return `{${nameOf(count)}} ${words}`;
  }
  const text = textIf((found) => found !== null, () => writtenText(node));
  return text ?? `{${nameOf(node)}}`;
}

/** Return the text of `make` if `isWanted` accepts it, else null; only then are the nodes in `used`. */
function textIf(isWanted, make) {
  const before = [...used];
  const text = make();
  if (isWanted(text)) return text;
  used.clear();
  for (const one of before) used.add(one);
  return null;
}

function textOfTemplate(node) {
  return node.quasis.map((quasi, index) => {
    const between = node.expressions[index];
    return (quasi.value.cooked ?? "") + (between === undefined ? "" : inBraces(between));
  }).join("");
}

/** Return the text of an element; for an element without text, the value of its first attribute in braces. */
function textOfElement(element) {
  const inner = writtenText(element);
  if (inner !== null && inner !== "") return inner;
  const given = element.openingElement?.attributes.map((one) => one.value?.expression).find((one) => one !== undefined);
  return element.children?.length === 0 && given !== undefined ? inBraces(given) : "<>";
}

/** Return the text between elements with its white space collapsed as in JSX. */
function lineText(value) {
  const lines = value.split("\n");
  return lines
    .map((line, at) => {
      const opened = at === 0 ? line : line.trimStart();
      return (at === lines.length - 1 ? opened : opened.trimEnd()).replace(/\s+/g, " ");
    })
    .filter((line) => line !== "")
    .join(" ");
}

function textOfChildren(children) {
  return children
    .map((child) => {
      switch (child.type) {
        case "JSXText":
          return lineText(child.value);
        case "JSXExpressionContainer":
          return child.expression.type === "JSXEmptyExpression" ? "" : inBraces(child.expression);
        default:
          return textOfElement(child);
      }
    })
    .join("");
}

function collect(tree) {
  const found = [];
  const keep = (node, text) => {
    const tidy = text.replace(/\s+/g, " ").trim();
    if (tidy !== "") found.push([node.start, tidy, node]);
  };
  /** Collect the strings below a node. `read`: true for every string, false for prose only, null for none. */
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
        const isWanted = (text) => read !== null && (read ? hasLetters(text) : isProse(text));
        const text = textIf(isWanted, () => textOfTemplate(node));
        if (text !== null) keep(node, text);
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
        if (node.children.some((child) => child.type === "JSXText" && hasLetters(child.value)))
          keep(node, textOfChildren(node.children));
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
  return found.filter(([, , node]) => !used.has(node)).sort((a, b) => a[0] - b[0]).map(([, text]) => text);
}

const all = {};
for (const file of files) {
  const parsed = parseSync(file, readFileSync(file, "utf8"));
  if (parsed.errors.length > 0) throw new Error(`${file}: ${parsed.errors[0].message}`);
  all[file] = collect(parsed.program);
}
process.stdout.write(JSON.stringify(all));
