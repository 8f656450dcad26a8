"""Generate ``web/src/wire/messages.ts``, ``views.ts`` and ``protocol/schema.json`` from their classes and tables.

Run ``python -m carina.server.wire.generate [REPOSITORY]``; ``--check`` only compares and exits with 1 on drift.
"""

from __future__ import annotations

import functools
import json
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import msgspec
from msgspec import inspect

from carina.commands import Look, all_commands
from carina.commands.fields import Outline, ViewName
from carina.export import EXPORT_FORMATS, EXPORT_TITLES
from carina.plan.turns.fork_view import AHEAD_DEG, AHEAD_TIMES
from carina.render import CELLS, FINDER_VIEW, LEAD_VIEW, VIEWS, Sight
from carina.server.wire import messages
from carina.server.wire.codec import type_name
from carina.volume.anatomical_planes import PLANES

HEAD = "// Generated from python/carina/render/view_table.py by `python -m carina.server.wire.generate`. Do not edit."
ROW_FIELDS = (
    "title",
    "short",
    "words",
    "empty",
    "cell",
    "needs",
    "overlay",
    "pick",
    "zoom",
    "plane",
    "slab",
    "windowed",
    "outlined",
    "scaled",
    "named",
    "straight",
    "orbit",
    "max_px",
)
"""Fields of a view that the client uses."""


def _value(value: Any) -> str:
    return json.dumps(sorted(value) if isinstance(value, frozenset) else msgspec.to_builtins(value), ensure_ascii=False)


def _table(name: str, key: str | None, words: str, rows: Mapping[Any, Mapping[str, Any]]) -> list[str]:
    lines = [f"/** {words} */", f"export const {name} = {{"]
    for row, fields in rows.items():
        lines.append(f"  {json.dumps(row)}: {{")
        lines += [f"    {field}: {_value(value)}," for field, value in fields.items()]
        lines.append("  },")
    lines.append("} as const;")
    return [*lines, *([] if key is None else [f"export type {key} = keyof typeof {name};"]), ""]


def views_typescript() -> str:
    """Return TypeScript constants of the views, cells and planes, whose types are their literal values."""
    planes = {
        name: {
            "axis": display.normal_axis,
            "right_axis": "xyz".index(display.right[-1]),
            "down_axis": "xyz".index(display.down[-1]),
            "next_slice": display.next_slice,
        }
        for name, display in PLANES.items()
    }
    cells = {
        cell.name: {
            "views": [row.name for row in VIEWS.values() if row.cell == cell.name],
            "chosen_by": cell.chosen_by,
            "next_action": cell.next_action,
            "list_name": cell.list_name,
            "all_when_wide": cell.all_when_wide,
            "side_by_side": cell.side_by_side,
        }
        for cell in CELLS.values()
    }
    views = {row.name: {field: getattr(row, field) for field in ROW_FIELDS} for row in VIEWS.values()}
    return "\n".join(
        [
            HEAD,
            "",
            *_table(
                "PLANES", "PlaneName", "Anatomical planes: patient axes of their normal and of the screen.", planes
            ),
            *_table("CELLS", "CellName", "Places of the window, and the views that each can show.", cells),
            *_table("VIEWS", None, "Views; `carina.render.ViewRow` describes the fields.", views),
            "/** Name of the airway view, which shows the picture of the scope. */",
            f"export const LEAD_VIEW = {json.dumps(LEAD_VIEW)};",
            "/** Name of the view that replaces the airway view while that view is too slow. */",
            f"export const FINDER_VIEW = {json.dumps(FINDER_VIEW)};",
            "",
        ]
    )


def exports_typescript() -> str:
    """Return TypeScript constants: the titles of the export formats in the order of the window, with their files."""
    lines = [
        "// Generated from python/carina/export/format_table.py by "
        "`python -m carina.server.wire.generate`. Do not edit.",
        "",
        "/** Export formats by content: title, suffixes of the files, and the programs that read them. */",
        "export const EXPORTS = [",
    ]
    for kind, title in EXPORT_TITLES.items():
        lines += ["  {", f"    title: {json.dumps(title)},", "    files: ["]
        lines += [
            f"      {{ suffix: {json.dumps(row.suffix)}, words: {json.dumps(row.words)} }},"
            for row in EXPORT_FORMATS
            if row.kind == kind
        ]
        lines += ["    ],", "  },"]
    return "\n".join([*lines, "] as const;", ""])


GROUPS = (
    ("ClientMessage", messages.CLIENT_MESSAGES),
    ("ServerMessage", messages.SERVER_MESSAGES),
    ("PhoneMessage", messages.PHONE_MESSAGES),
    ("ToPhoneMessage", messages.TO_PHONE_MESSAGES),
)
PROGRAM_GROUPS = (("JoinMessage", messages.JOIN_MESSAGES), ("ToJoinMessage", messages.TO_JOIN_MESSAGES))
"""Message groups that no web page uses; they are only in the schema, not in the generated TypeScript."""


def _struct(cls: type[Any]) -> inspect.StructType:
    found = inspect.type_info(cls)
    assert isinstance(found, inspect.StructType)
    return found


def _inner_types(kind: inspect.Type) -> tuple[inspect.Type, ...]:
    match kind:
        case inspect.UnionType():
            return kind.types
        case inspect.TupleType():
            return kind.item_types
        case inspect.VarTupleType():
            return (kind.item_type,)
        case inspect.DictType():
            return (kind.value_type,)
    return ()


def _classes_within(whole: Iterable[type[Any]]) -> dict[type[Any], None]:
    """Return these classes and all classes in their fields, each once, inner classes first."""
    found: dict[type[Any], None] = {}

    def visit(kind: inspect.Type) -> None:
        if not isinstance(kind, inspect.StructType):
            for inner in _inner_types(kind):
                visit(inner)
        elif kind.cls not in found:
            for field in kind.fields:
                visit(field.type)
            found[kind.cls] = None

    for cls in whole:
        visit(_struct(cls))
    return found


Groups = tuple[tuple[str, dict[str, type[Any]]], ...]


def _classes_of_groups(groups: Groups = GROUPS) -> list[type[Any]]:
    """Return all message classes and all classes in their fields, each once, inner classes first."""
    return list(_classes_within([*(cls for _, classes in groups for cls in classes.values()), messages.PictureHeader]))


@functools.cache
def _classes_from_server() -> set[type[Any]]:
    """Return the classes that only the server sends; it writes every field, also fields with a default."""
    server_groups = (messages.SERVER_MESSAGES, messages.TO_PHONE_MESSAGES, messages.TO_JOIN_MESSAGES)
    client_groups = (messages.CLIENT_MESSAGES, messages.PHONE_MESSAGES, messages.JOIN_MESSAGES)
    sent, received = (
        _classes_within([cls for group in groups for cls in group.values()])
        for groups in (server_groups, client_groups)
    )
    return set(sent) - set(received)


def _is_required(cls: type[Any], field: inspect.Field) -> bool:
    return field.required or cls in _classes_from_server()


def _ts_name(cls: type[Any]) -> str:
    """Return the name of a class in TypeScript and in the schema.

    The name of a message ends in ``Message``. ``wire_name`` of a class replaces its name in Python.
    """
    wire_name = vars(cls).get("wire_name")
    if wire_name is not None:
        return str(wire_name)
    suffix = "Message" if type_name(cls) is not None and not cls.__name__.endswith("Message") else ""
    return str(getattr(cls, "typescript_prefix", "")) + cls.__name__ + suffix


def _ts_list(item: str) -> str:
    return f"readonly ({item})[]" if " " in item else f"readonly {item}[]"


def _ts_type(kind: inspect.Type) -> str:
    match kind:
        case inspect.UnionType():
            return " | ".join(map(_ts_type, sorted(kind.types, key=lambda one: isinstance(one, inspect.NoneType))))
        case inspect.LiteralType():
            return " | ".join(json.dumps(value) for value in kind.values)
        case inspect.TupleType():
            return f"readonly [{', '.join(map(_ts_type, kind.item_types))}]"
        case inspect.VarTupleType():
            return _ts_list(_ts_type(kind.item_type))
        case inspect.StructType():
            return _ts_name(kind.cls)
        case inspect.DictType():
            of = "unknown" if isinstance(kind.value_type, inspect.AnyType) else _ts_type(kind.value_type)
            return f"Readonly<Record<string, {of}>>"
        case inspect.NoneType():
            return "null"
        case inspect.BoolType():
            return "boolean"
        case inspect.IntType() | inspect.FloatType():
            return "number"
        case inspect.StrType():
            return "string"
    raise TypeError(f"no type of TypeScript for {kind!r}")


def _tag(struct: inspect.StructType) -> tuple[str, str] | None:
    return None if struct.tag_field is None else (struct.tag_field, str(struct.tag))


def typescript() -> str:
    """Return the text of ``messages.ts``."""
    lines = [
        "// Generated from python/carina/commands and python/carina/server/wire/messages.py by",
        "// `python -m carina.server.wire.generate`. Do not edit.",
        "",
        f"export const WIRE_VERSION = {messages.WIRE_VERSION};",
        "",
        "export const CLOSE_CODES = {",
        *(f"  {json.dumps(name)}: {code}," for name, code in messages.CLOSE_CODES.items()),
        "} as const;",
        "",
        "/** Largest angle of an opening straight ahead, degrees; least ratio of the other openings' angles to it. */",
        f"export const STRAIGHT_AHEAD = {{ most_deg: {AHEAD_DEG}, times: {AHEAD_TIMES} }} as const;",
        "",
        "/** 4x4, row-major. */",
        "export type Matrix4 = readonly number[];",
        f"export type ViewName = {_ts_type(inspect.type_info(ViewName))};",
        f"export type Outline = {_ts_type(inspect.type_info(Outline))};",
        "",
    ]
    for cls in _classes_of_groups():
        struct = _struct(cls)
        documentation = (cls.__doc__ or "").strip().replace("``", "`")
        lines.append(f"/** {documentation} */")
        lines.append(f"export interface {_ts_name(cls)} {{")
        if tag := _tag(struct):
            lines.append(f"  readonly {tag[0]}: {json.dumps(tag[1])};")
        for field in struct.fields:
            lines.append(f"  readonly {field.name}{'' if _is_required(cls, field) else '?'}: {_ts_type(field.type)};")
        lines += ["}", ""]
    lines += _display_fields()
    for name, classes in GROUPS:
        lines += [f"export type {name} =", *(f"  | {_ts_name(cls)}" for cls in classes.values())]
        lines[-1] += ";"
        lines.append("")
    return "\n".join(lines)


def _display_fields() -> list[str]:
    """Return the defaults of look and sight, and the commands that only set one of their fields."""
    lines = []
    commands = {type_name(cls) for cls in all_commands()}
    for name, value in (("LOOK", Look()), ("SIGHT", Sight())):
        lines += [
            f"/** Initial value of `{name.lower()}`. */",
            f"export const FIRST_{name}: {type(value).__name__} = {json.dumps(msgspec.to_builtins(value), indent=2)};",
            "",
        ]
    lines += [
        "/**",
        " * Commands that set one field of `look` or `sight`, to the value of their field `from`; null uses all fields",
        " * of the command. With `by_view` the field has a value for each view.",
        " */",
        "export const SETS = {",
    ]
    for cls in all_commands():
        if cls.sets is not None:
            fields = [field for field in cls.__struct_fields__ if field != "view"]
            row = {
                "of": "look" if cls.sets in Look.__struct_fields__ else "sight",
                "field": cls.sets,
                "from": None if cls.value_class() else fields[0],
                "by_view": "view" in cls.__struct_fields__,
            }
            words = ", ".join(f"{name}: {json.dumps(value)}" for name, value in row.items())
            lines.append(f"  {type_name(cls)}: {{ {words} }},")
    no_commands = ", ".join(json.dumps(name) for name in messages.CLIENT_MESSAGES if name not in commands)
    return [
        *lines,
        "} as const;",
        "",
        "/** Messages of a client that are not commands; `handled` does not count them. */",
        f"export const NO_COMMANDS: readonly string[] = [{no_commands}];",
        "",
    ]


def _schema_of(kind: inspect.Type) -> dict[str, Any]:
    match kind:
        case inspect.UnionType():
            ordered = sorted(kind.types, key=lambda one: isinstance(one, inspect.NoneType))
            return {"anyOf": [_schema_of(one) for one in ordered]}
        case inspect.LiteralType():
            return {"enum": list(kind.values)}
        case inspect.TupleType():
            length = len(kind.item_types)
            items = [_schema_of(item) for item in kind.item_types]
            entries = {"items": items[0]} if all(item == items[0] for item in items) else {"prefixItems": items}
            return {"type": "array", **entries, "minItems": length, "maxItems": length}
        case inspect.VarTupleType():
            return {"type": "array", "items": _schema_of(kind.item_type)} | _bounds(kind, "Items")
        case inspect.StructType():
            return {"$ref": f"#/$defs/{_ts_name(kind.cls)}"}
        case inspect.DictType():
            any_value = isinstance(kind.value_type, inspect.AnyType)
            return {"type": "object"} | ({} if any_value else {"additionalProperties": _schema_of(kind.value_type)})
        case inspect.NoneType():
            return {"type": "null"}
        case inspect.BoolType():
            return {"type": "boolean"}
        case inspect.IntType() | inspect.FloatType():
            bounds = {"minimum": kind.ge, "maximum": kind.le}
            number = "integer" if isinstance(kind, inspect.IntType) else "number"
            return {"type": number} | {name: bound for name, bound in bounds.items() if bound is not None}
        case inspect.StrType():
            return {"type": "string"} | _bounds(kind, "Length")
    raise TypeError(f"no schema for {kind!r}")


def _bounds(kind: inspect.VarTupleType | inspect.StrType, what: str) -> dict[str, int]:
    if kind.min_length is None and kind.max_length is None:
        return {}
    found = {f"min{what}": kind.min_length or 0}
    return found if kind.max_length is None else found | {f"max{what}": kind.max_length}


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema of the messages in both directions and of the frame header."""
    definitions: dict[str, Any] = {}
    for cls in _classes_of_groups(GROUPS + PROGRAM_GROUPS):
        struct = _struct(cls)
        properties = {field.name: _schema_of(field.type) for field in struct.fields}
        required = [field.name for field in struct.fields if _is_required(cls, field)]
        if tag := _tag(struct):
            constant = {"const": tag[1]} if tag[0] == "type" else {"enum": [tag[1]]}
            properties = {tag[0]: constant, **properties}
            required = [tag[0], *required]
        definitions[_ts_name(cls)] = {
            "description": (cls.__doc__ or "").strip(),
            "type": "object",
            "properties": properties,
            "required": required,
            "additionalProperties": not struct.forbid_unknown_fields,
        }
    for name, classes in GROUPS + PROGRAM_GROUPS:
        definitions[name] = {"oneOf": [{"$ref": f"#/$defs/{_ts_name(cls)}"} for cls in classes.values()]}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Carina wire",
        "wire_version": messages.WIRE_VERSION,
        "close_codes": messages.CLOSE_CODES,
        "$defs": definitions,
    }


def generated_files() -> dict[str, str]:
    """Return the generated text of each file by its path in the repository."""
    return {
        "web/src/wire/messages.ts": typescript(),
        "web/src/wire/views.ts": views_typescript(),
        "web/src/wire/exports.ts": exports_typescript(),
        "protocol/schema.json": json.dumps(json_schema(), indent=1) + "\n",
    }


def main(arguments: list[str]) -> int:
    """Write the generated files, or compare them with ``--check``, and return the exit status."""
    check = "--check" in arguments
    places = [a for a in arguments if not a.startswith("--")]
    repository = Path(places[0]) if places else Path(__file__).resolve().parents[4]
    drifted = []
    for name, text in generated_files().items():
        path = repository / name
        if path.exists() and path.read_text(encoding="utf-8") == text:
            continue
        drifted.append(name)
        if not check:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
    for name in drifted:
        print(
            f"{name}: {'differs from its classes; run python -m carina.server.wire.generate' if check else 'written'}"
        )
    return 1 if check and drifted else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
