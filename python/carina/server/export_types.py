"""The table of export formats for the web client: the text of ``web/src/wire/exports.ts``, for ``wire_types``."""

from __future__ import annotations

import json

from carina.export import EXPORT_FORMATS, EXPORT_TITLES

__all__ = ["exports_typescript"]


def exports_typescript() -> str:
    """Return TypeScript constants: the titles of the export formats in the order of the window, with their files."""
    lines = [
        "// Generated from python/carina/export/format_table.py by `python -m carina.server.wire_types`. Do not edit.",
        "",
        "/** What a person calls it, the files that hold it, and who reads those. */",
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
