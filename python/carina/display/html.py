"""HTML elements for notebooks: embedded images, tables and captions, without style sheets or scripts."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from carina.display.png import png_bytes

NOT_FOR_DIAGNOSIS = "not for diagnosis"


def escaped(text: object) -> str:
    """Return a text with the special characters of HTML escaped."""
    return html.escape(str(text))


def picture(rgb: NDArray[np.uint8], alt: str) -> str:
    """Return an ``img`` element with an embedded PNG of ``rgb``, shape (height, width, 3), uint8."""
    data = base64.b64encode(png_bytes(np.ascontiguousarray(rgb))).decode("ascii")
    height, width = rgb.shape[:2]
    return (
        f'<img alt="{escaped(alt)}" src="data:image/png;base64,{data}" width="{width}" height="{height}" '
        'style="display:inline-block;margin:0 4px 0 0;background:#000">'
    )


def caption(lines: Iterable[str]) -> str:
    """Return small lines below a figure; the last line is *not for diagnosis*."""
    shown = "<br>".join(escaped(line) for line in [*lines, NOT_FOR_DIAGNOSIS])
    return f'<div style="font-size:85%;opacity:0.8;line-height:1.4">{shown}</div>'


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a small table with right-aligned numbers."""

    def cell(value: object) -> str:
        side = "right" if isinstance(value, int | float) else "left"
        text = "" if value is None else f"{value:.1f}" if isinstance(value, float) else str(value)
        return f'<td style="text-align:{side};padding:1px 8px">{escaped(text)}</td>'

    top = "".join(f'<th style="text-align:left;padding:1px 8px">{escaped(name)}</th>' for name in head)
    body = "".join(f"<tr>{''.join(cell(value) for value in row)}</tr>" for row in rows)
    return f'<table style="font-size:85%;border-collapse:collapse"><tr>{top}</tr>{body}</table>'


def figure(*parts: str) -> str:
    """Return a ``div`` element that contains all parts of one value."""
    return f'<div style="max-width:900px">{"".join(parts)}</div>'
