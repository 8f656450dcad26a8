"""The table of views for the web client: the text of ``web/src/wire/views.ts``, written by ``wire_types``."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import msgspec

from carina.render import CELLS, FINDER_VIEW, LEAD_VIEW, VIEWS
from carina.volume.planes import PLANES

__all__ = ["views_typescript"]

HEAD = "// Generated from python/carina/render/view_table.py by `python -m carina.server.wire_types`. Do not edit."
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
            *_table("VIEWS", None, "Views; `carina.render.ViewRow` says what the fields mean.", views),
            "/** What the scope sees. */",
            f"export const LEAD_VIEW = {json.dumps(LEAD_VIEW)};",
            "/** Stands in for it where it cannot follow. */",
            f"export const FINDER_VIEW = {json.dumps(FINDER_VIEW)};",
            "",
        ]
    )
