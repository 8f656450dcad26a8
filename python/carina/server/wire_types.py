"""Generate ``web/src/wire/messages.ts``, ``views.ts`` and ``protocol/schema.json`` from their classes and tables.

Run ``python -m carina.server.wire_types [REPOSITORY]``; ``--check`` only compares and exits with 1 on drift.
"""

from __future__ import annotations

import dataclasses
import json
import sys
import types
import typing
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from carina.server import messages
from carina.server.view_types import views_typescript
from carina.server.wire_codec import Length, Range, field_types, optional_fields

__all__ = ["generated_files", "json_schema", "main", "typescript"]

GROUPS = (
    ("ClientMessage", messages.CLIENT_MESSAGES),
    ("ServerMessage", messages.SERVER_MESSAGES),
    ("PhoneMessage", messages.PHONE_MESSAGES),
    ("ToPhoneMessage", messages.TO_PHONE_MESSAGES),
)


def _unwrap(hint: Any) -> tuple[Any, list[Any]]:
    if get_origin(hint) is Annotated:
        inner, *metadata = get_args(hint)
        return inner, list(metadata)
    return hint, []


def _choices(hint: Any) -> list[Any] | None:
    return list(get_args(hint)) if get_origin(hint) in (Union, types.UnionType) else None


def _nested(classes: list[type[Any]]) -> list[type[Any]]:
    """The classes and every dataclass their fields name, each once, inner ones first."""
    found: list[type[Any]] = []

    def visit(hint: Any) -> None:
        hint, _ = _unwrap(hint)
        if dataclasses.is_dataclass(hint):
            cls = typing.cast(type[Any], hint)
            if cls not in found:
                for inner in field_types(cls).values():
                    visit(inner)
                found.append(cls)
        else:
            for inner in get_args(hint):
                visit(inner)

    for cls in classes:
        visit(cls)
    return found


def _all_classes() -> list[type[Any]]:
    return _nested([*(cls for _, classes in GROUPS for cls in classes.values()), messages.PictureHeader])


def _ts_name(cls: type[Any]) -> str:
    return cls.__name__ + ("Message" if hasattr(cls, "wire_type") else "")


def _ts_type(hint: Any) -> str:
    hint, metadata = _unwrap(hint)
    choices = _choices(hint)
    if choices is not None:
        return " | ".join("null" if c is type(None) else _ts_type(c) for c in choices)
    origin = get_origin(hint)
    if origin is Literal:
        return " | ".join(json.dumps(value) for value in get_args(hint))
    if origin is tuple:
        item = _ts_type(get_args(hint)[0])
        lengths = [m for m in metadata if isinstance(m, Length) and m.low == m.high <= 4]
        if lengths:
            return f"readonly [{', '.join([item] * lengths[0].low)}]"
        return (
            f"readonly ({item})[]"
            if "|" in item
            else f"readonly {item}[]"
            if " " not in item
            else f"readonly ({item})[]"
        )
    if origin is dict:
        return "Record<string, unknown>"
    if dataclasses.is_dataclass(hint):
        return _ts_name(typing.cast(type[Any], hint))
    return {bool: "boolean", int: "number", float: "number", str: "string"}[hint]


def typescript() -> str:
    """The text of ``messages.ts``."""
    lines = [
        "// Generated from python/carina/server/messages.py by `python -m carina.server.wire_types`. Do not edit.",
        "",
        f"export const WIRE_VERSION = {messages.WIRE_VERSION};",
        "",
        "export const CLOSE_CODES = {",
        *(f"  {json.dumps(name)}: {code}," for name, code in messages.CLOSE_CODES.items()),
        "} as const;",
        "",
        "/** 4x4, row-major. */",
        "export type Matrix4 = readonly number[];",
        f"export type ViewName = {_ts_type(messages.ViewName)};",
        f"export type Mask = {_ts_type(messages.Mask)};",
        "",
    ]
    for cls in _all_classes():
        documentation = (cls.__doc__ or "").strip().replace("``", "`")
        lines.append(f"/** {documentation} */")
        lines.append(f"export interface {_ts_name(cls)} {{")
        if hasattr(cls, "wire_type"):
            lines.append(f"  readonly type: {json.dumps(cls.wire_type)};")
        optional = optional_fields(cls)
        for name, hint in field_types(cls).items():
            lines.append(f"  readonly {name}{'?' if name in optional else ''}: {_ts_type(hint)};")
        lines += ["}", ""]
    for name, classes in GROUPS:
        lines += [f"export type {name} =", *(f"  | {_ts_name(cls)}" for cls in classes.values())]
        lines[-1] += ";"
        lines.append("")
    return "\n".join(lines)


def _schema_of(hint: Any) -> dict[str, Any]:
    hint, metadata = _unwrap(hint)
    choices = _choices(hint)
    if choices is not None:
        return {"anyOf": [{"type": "null"} if c is type(None) else _schema_of(c) for c in choices]}
    origin = get_origin(hint)
    schema: dict[str, Any]
    if origin is Literal:
        return {"enum": list(get_args(hint))}
    if origin is tuple:
        schema = {"type": "array", "items": _schema_of(get_args(hint)[0])}
        for bound in metadata:
            if isinstance(bound, Length):
                schema |= {"minItems": bound.low, "maxItems": bound.high}
        return schema
    if origin is dict:
        return {"type": "object"}
    if dataclasses.is_dataclass(hint):
        return {"$ref": f"#/$defs/{_ts_name(typing.cast(type[Any], hint))}"}
    schema = {"type": {bool: "boolean", int: "integer", float: "number", str: "string"}[hint]}
    for bound in metadata:
        if isinstance(bound, Range):
            schema |= {"minimum": bound.low, "maximum": bound.high}
        if isinstance(bound, Length):
            schema |= {"minLength": bound.low, "maxLength": bound.high}
    return schema


def json_schema() -> dict[str, Any]:
    """JSON Schema of both directions and of the picture header."""
    definitions: dict[str, Any] = {}
    for cls in _all_classes():
        properties = {name: _schema_of(hint) for name, hint in field_types(cls).items()}
        if hasattr(cls, "wire_type"):
            properties = {"type": {"const": cls.wire_type}, **properties}
        definitions[_ts_name(cls)] = {
            "description": (cls.__doc__ or "").strip(),
            "type": "object",
            "properties": properties,
            "required": [name for name in properties if name not in optional_fields(cls)],
            "additionalProperties": bool(getattr(cls, "extra_keys_allowed", False)),
        }
    for name, classes in GROUPS:
        definitions[name] = {"oneOf": [{"$ref": f"#/$defs/{_ts_name(cls)}"} for cls in classes.values()]}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Carina wire",
        "wire_version": messages.WIRE_VERSION,
        "close_codes": messages.CLOSE_CODES,
        "$defs": definitions,
    }


def generated_files() -> dict[str, str]:
    """Path in the repository -> text."""
    return {
        "web/src/wire/messages.ts": typescript(),
        "web/src/wire/views.ts": views_typescript(),
        "protocol/schema.json": json.dumps(json_schema(), indent=1) + "\n",
    }


def main(arguments: list[str]) -> int:
    """Write or compare; see the module's first line."""
    check = "--check" in arguments
    places = [a for a in arguments if not a.startswith("--")]
    repository = Path(places[0]) if places else Path(__file__).resolve().parents[3]
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
        print(f"{name}: {'differs from messages.py; run python -m carina.server.wire_types' if check else 'written'}")
    return 1 if check and drifted else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
