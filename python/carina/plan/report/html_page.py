"""Report as one HTML page that contains all images, styles and scripts and loads nothing from a network."""

from __future__ import annotations

import base64
import hashlib
import json
from importlib.resources import files

from carina.display.html import escaped
from carina.plan.report.blocks import Block, Bullets, Clip, Facts, Figure, Figures, ReportTable, Section, Words
from carina.plan.report.drawing import svg
from carina.plan.report.plan_sheet import PlanSheet, target_words
from carina.plan.report.uncertainty import movement_words
from carina.plan.report.wording import NOT_A_DEVICE

TITLE = "Bronchoscopy plan"
VIEWS = ("front", "back", "left", "right", "above", "below")
TREE_AFTER = "airways"
"""Name of the section after whose content the interactive tree is inserted."""
PLAY, STOP = "Play the way there", "Stop"


def html_page(sheet: PlanSheet, parts: tuple[Section, ...]) -> str:
    """Return an HTML document of these sections; it loads nothing, and all text is escaped."""
    here = files("carina.plan.report")
    style = here.joinpath("page.css").read_text(encoding="utf-8")
    # A page break before the first section would leave an empty page after the title.
    body = "".join(_section(part, is_first=n == 0) for n, part in enumerate(parts))
    has_tree = any(part.name == TREE_AFTER for part in parts)
    wanted = {"page.js": has_tree, "clips.js": any(_has_clip(block) for part in parts for block in part.blocks)}
    scripts = [here.joinpath(name).read_text(encoding="utf-8") for name, is_wanted in wanted.items() if is_wanted]
    allowed = " ".join(f"'{_hash(one)}'" for one in scripts) or "'none'"
    policy = (
        f"default-src 'none'; img-src data:; style-src '{_hash(style)}'; "
        f"script-src {allowed}; base-uri 'none'; form-action 'none'"
    )
    # The escape prevents the data from closing its script element.
    tree = json.dumps(sheet.shape.to_json(), separators=(",", ":")).replace("<", "\\u003c")
    # A sheet alone has no printed title, so that each of its drawings fits on one page.
    kind = ' class="sheet-alone"' if all(part.name.startswith("tracing") for part in parts) else ""
    tail = f'<script type="application/json" id="tree-data">{tree}</script>' if has_tree else ""
    tail += "".join(f"<script>{one}</script>" for one in scripts)
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{escaped(policy)}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<meta name="referrer" content="no-referrer">'
        f'<link rel="icon" href="data:,"><title>{TITLE}</title><style>{style}</style></head>'
        f"<body{kind}>"
        f"{_running(sheet)}"
        '<table class="sheet" role="presentation"><thead><tr><td></td></tr></thead><tfoot><tr><td></td></tr></tfoot>'
        f"<tbody><tr><td>{_head(sheet, parts)}{body}{_foot(sheet)}</td></tr></tbody>"
        f"</table>{tail}</body></html>\n"
    )


def _hash(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def _running(sheet: PlanSheet) -> str:
    """Return the HTML of the head and foot of each printed page."""
    who = "" if sheet.patient is None else f" \u00b7 {sheet.patient}"
    left, right = (
        f"{TITLE}{who} \u00b7 {target_words(sheet)}",
        f"Carina {sheet.provenance.version}, {sheet.provenance.made_on}",
    )
    return (
        f'<div class="running top" aria-hidden="true"><span>{escaped(left)}</span><span>{escaped(right)}</span></div>'
        f'<div class="running bottom" aria-hidden="true"><span>{escaped(NOT_A_DEVICE)}</span>'
        f"<span>{escaped(movement_words(sheet.plan))}</span></div>"
    )


def _head(sheet: PlanSheet, parts: tuple[Section, ...]) -> str:
    who = "" if sheet.patient is None else f"<p><strong>{escaped(sheet.patient)}</strong></p>"
    links = "".join(f'<a href="#{escaped(part.name)}">{escaped(part.title)}</a>' for part in parts)
    made = f"Carina {sheet.provenance.version}, {sheet.provenance.made_on}"
    return (
        f'<header class="title"><h1>{TITLE}</h1>{who}<p class="on-screen">{escaped(made)}</p></header>'
        f'<p class="safety">{escaped(NOT_A_DEVICE)} {escaped(movement_words(sheet.plan))}</p><nav>{links}</nav>'
    )


def _foot(sheet: PlanSheet) -> str:
    return f'<footer class="end">{escaped(NOT_A_DEVICE)} {escaped(movement_words(sheet.plan))}</footer>'


def _section(part: Section, *, is_first: bool) -> str:
    kinds = ["starts-page"] * (part.starts_page and not is_first) + ["whole"] * part.is_whole
    starts = f' class="{" ".join(kinds)}"' if kinds else ""
    blocks = [_block(block) for block in part.blocks]
    if part.name == TREE_AFTER:
        # The screen shows an interactive tree, paper shows the tree from two sides.
        blocks[-1] = f'<div class="on-paper">{blocks[-1]}</div>{_tree()}'
    return f'<section id="{escaped(part.name)}"{starts}><h2>{escaped(part.title)}</h2>{"".join(blocks)}</section>'


def _tree() -> str:
    buttons = "".join(f'<button type="button" data-look="{name}">{name.capitalize()}</button>' for name in VIEWS)
    help_words = (
        "Drag to turn, Shift and drag to move, + and \u2212 to zoom; arrow keys turn, and the keys A, P, L, R, S, I "
        "look from that side."
    )
    return (
        '<div class="on-screen"><div class="space"><canvas id="tree" tabindex="0" role="img" aria-label="Airway tree '
        f'with the route and the target, to be turned" aria-describedby="tree-help"></canvas></div>'
        f'<div class="views">{buttons}</div><p class="quiet" id="tree-help">{help_words}</p></div>'
    )


def _block(block: Block) -> str:
    match block:
        case Words(text=text, tone=tone):
            return f"<p{_tone(tone)}>{escaped(text)}</p>"
        case Bullets(items=items, tone=tone, warned=warned):
            rows = (
                f"<li{_tone('warning') if n in warned else ''}>{escaped(item)}</li>" for n, item in enumerate(items)
            )
            return f"<ul{_tone(tone)}>{''.join(rows)}</ul>"
        case Facts(rows=rows):
            inner = "".join(f"<div><dt>{escaped(k)}</dt><dd>{escaped(v)}</dd></div>" for k, v in rows)
            return f'<dl class="facts">{inner}</dl>'
        case ReportTable():
            return _table(block)
        case Figure():
            return _figure(block)
        case Figures(items=items, columns=columns):
            many = " many" if len(items) > columns else ""
            return f'<div class="row of-{columns}{many}">{"".join(_figure(one) for one in items)}</div>'


def _tone(tone: str) -> str:
    return "" if tone == "plain" else f' class="{tone}"'


def _table(grid: ReportTable) -> str:
    columns = "".join(f'<col width="{100 * share:.1f}%">' for share in grid.shares)
    head = "".join(f'<th scope="col">{escaped(name)}</th>' for name in grid.head)
    rows = []
    for n, row in enumerate(grid.rows):
        cells = "".join(f"<td>{escaped(cell)}</td>" for cell in row)
        rows.append(f"<tr{_tone('warning') if n in grid.warned else ''}>{cells}</tr>")
    return (
        f'<div class="wide"><table><colgroup>{columns}</colgroup><thead><tr>{head}</tr></thead>'
        f"<tbody>{''.join(rows)}</tbody></table></div>"
    )


def _figure(figure: Figure) -> str:
    words = f"<figcaption>{escaped(figure.caption)}</figcaption>" if figure.caption else ""
    if figure.clip is None:
        return f"<figure>{svg(figure.drawing)}{words}</figure>"
    return f'<figure><div class="picture">{svg(figure.drawing)}</div>{_clip(figure.clip)}{words}</figure>'


def _has_clip(block: Block) -> bool:
    figures = block.items if isinstance(block, Figures) else (block,)
    return any(isinstance(one, Figure) and one.clip is not None for one in figures)


def _clip(clip: Clip) -> str:
    """Return the HTML of a clip's frames and controls; they are hidden until the script that plays them runs."""
    data = base64.b64encode(clip.strip_jpeg).decode("ascii")
    return (
        f'<div class="clip on-screen" data-seconds="{clip.duration_s:.2f}" hidden>'
        f'<button type="button" data-play="{PLAY}" data-stop="{STOP}" aria-label="{PLAY}: {escaped(clip.says)}">{PLAY}'
        f'</button><input type="range" min="0" max="{clip.num_frames}" value="{clip.num_frames}" '
        f'aria-label="Place on the way: {escaped(clip.says)}">'
        f'<img hidden alt="" src="data:image/jpeg;base64,{data}"></div>'
    )
