"""Pieces of HTML for notebooks: pictures inside the page, tables, notes. No style sheet and no script of their own."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from carina.display.png import png_bytes

__all__ = ["caption", "escaped", "figure", "picture", "table"]

NOT_FOR_DIAGNOSIS = "not for diagnosis"


def escaped(text: object) -> str:
    """Text that is shown as it is, whatever characters it holds."""
    return html.escape(str(text))


def picture(rgb: NDArray[np.uint8], alt: str) -> str:
    """A picture, (height, width, 3) uint8, inside the page."""
    data = base64.b64encode(png_bytes(np.ascontiguousarray(rgb))).decode("ascii")
    height, width = rgb.shape[:2]
    return (
        f'<img alt="{escaped(alt)}" src="data:image/png;base64,{data}" width="{width}" height="{height}" '
        'style="display:inline-block;margin:0 4px 0 0;background:#000">'
    )


def caption(lines: Iterable[str]) -> str:
    """Small lines below a figure; the last says what it is not for."""
    shown = "<br>".join(escaped(line) for line in [*lines, NOT_FOR_DIAGNOSIS])
    return f'<div style="font-size:85%;opacity:0.8;line-height:1.4">{shown}</div>'


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A small table; numbers stand at the right."""

    def cell(value: object) -> str:
        side = "right" if isinstance(value, int | float) else "left"
        text = "" if value is None else f"{value:.1f}" if isinstance(value, float) else str(value)
        return f'<td style="text-align:{side};padding:1px 8px">{escaped(text)}</td>'

    top = "".join(f'<th style="text-align:left;padding:1px 8px">{escaped(name)}</th>' for name in head)
    body = "".join(f"<tr>{''.join(cell(value) for value in row)}</tr>" for row in rows)
    return f'<table style="font-size:85%;border-collapse:collapse"><tr>{top}</tr>{body}</table>'


def figure(*parts: str) -> str:
    """All of one value."""
    return f'<div style="max-width:900px">{"".join(parts)}</div>'
