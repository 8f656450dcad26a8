"""Run a notebook without a notebook server, and write its output as one HTML page.

    python tools/run_notebook.py examples/04_notebook/from_ct_to_film.ipynb -o page.html

Cells run in order in one namespace, in a new folder. As in a notebook, the last line of a cell is shown if it is an
expression: by ``_repr_html_``, ``_repr_png_`` or ``repr``. Magics and widgets are not supported on purpose: an example
should not need them. The notebook in the repository contains no outputs.
"""

from __future__ import annotations

import argparse
import ast
import base64
import contextlib
import html
import io
import json
import os
import re
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

STYLE = (
    "body{font:16px/1.5 sans-serif;max-width:960px;margin:2em auto}"
    "pre{background:#f4f5f7;padding:.7em;white-space:pre-wrap}"
)
"""CSS of the HTML page of a notebook."""


@dataclass(frozen=True)
class Shown:
    """Cell of a notebook that was run, with its output."""

    kind: str
    source: str
    value: Any = None
    """Value of the last line of the cell; None if this line is not an expression."""
    printed: str = ""


def run_notebook(path: Path, folder: Path) -> tuple[list[Shown], dict[str, Any]]:
    """Run all cells with ``folder`` as the working folder; return the cells with their output, and the namespace."""
    document = json.loads(path.read_text(encoding="utf-8"))
    names: dict[str, Any] = {"__name__": "__main__"}
    cells = []
    before = Path.cwd()
    os.chdir(folder)
    try:
        for number, cell in enumerate(document["cells"]):
            source = "".join(cell["source"])
            if cell["cell_type"] != "code":
                cells.append(Shown(cell["cell_type"], source))
                continue
            if cell["outputs"]:
                sys.exit(f"{path.name}: cell {number} holds outputs; clear them before you commit")
            cells.append(_run(source, f"<cell {number} of {path.name}>", names))
    finally:
        os.chdir(before)
    return cells, names


def _run(source: str, where: str, names: dict[str, Any]) -> Shown:
    tree = ast.parse(source, where)
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        exec(compile(tree, where, "exec"), names)
        expression = None if last is None else compile(ast.Expression(last.value), where, "eval")
        value = None if expression is None else eval(expression, names)
    return Shown("code", source, value, out.getvalue())


def as_html(cells: list[Shown], title: str) -> str:
    """Return the cells and their output as one HTML page."""
    parts = []
    for cell in cells:
        if cell.kind == "markdown":
            parts.append(_markdown(cell.source))
            continue
        parts.append(f"<pre>{html.escape(cell.source)}</pre>")
        if cell.printed:
            parts.append(f"<samp>{html.escape(cell.printed)}</samp>")
        if cell.value is not None:
            parts.append(_drawn(cell.value))
    head = f'<meta charset="utf-8"><title>{html.escape(title)}</title><style>{STYLE}</style>'
    return f"<!doctype html><html lang=en><head>{head}</head><body>{''.join(parts)}</body></html>\n"


def _drawn(value: Any) -> str:
    if hasattr(value, "_repr_html_"):
        return str(value._repr_html_())
    if hasattr(value, "_repr_png_"):
        data = base64.b64encode(value._repr_png_()).decode("ascii")
        return f'<p><img alt="{html.escape(repr(value))}" src="data:image/png;base64,{data}"></p>'
    return f"<p><samp>{html.escape(repr(value))}</samp></p>"


def _markdown(text: str) -> str:
    """Return HTML for the Markdown that examples use: headings, paragraphs and inline code."""
    blocks = []
    for block in text.split("\n\n"):
        words = re.sub(r"`([^`]+)`", r"<code>\1</code>", html.escape(block))
        level = len(block) - len(block.lstrip("#"))
        blocks.append(f"<h{level}>{words[level:].strip()}</h{level}>" if level else f"<p>{words}</p>")
    return "".join(blocks)


def main() -> int:
    """Run the notebook given on the command line, and write its HTML page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("notebook", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        cells, _ = run_notebook(arguments.notebook.resolve(), Path(folder))
        arguments.output.write_text(as_html(cells, arguments.notebook.stem), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
