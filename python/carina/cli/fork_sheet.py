"""``carina render --view forks``: a contact sheet of all forks of a route."""

from __future__ import annotations

from pathlib import Path

from carina.cli.along import check_destination, print_drawn_parts, route_to
from carina.cli.arguments import check_output_file
from carina.cli.console import interruptible, print_json, print_note, progress_printer
from carina.cli.opened import check_case_options, open_input
from carina.disk import write_whole
from carina.session.flights.fork_sheet import check_forks, fork_sheet_png

FORK_SHEET = "forks"
"""Name of the sheet as a view of the command; the window saves the sheet of the chosen route."""


def write_fork_sheet(
    path: Path, *, output: Path, to: str | None, series: str | None, strict: bool, ct: Path | None, as_json: bool
) -> int:
    """Render the forks of a route, and write one PNG."""
    check_output_file(output, ".png")
    to = check_destination(to, FORK_SHEET)
    check_case_options(path, ct)
    progress = progress_printer()
    source = open_input(path, series=series, strict=strict, progress=progress, ct=ct)
    way = route_to(source, to, tree_file=None, progress=progress)
    cost = "lumen" if source.document is None else source.document.cost_of(way)
    check_forks(way, cost)
    print_drawn_parts(way)
    airways = source.airways(progress)
    source.badges.add(getattr(airways, "badges", ()))
    operator = "head" if source.document is None else source.document.look.operator
    png = interruptible(
        lambda: fork_sheet_png(source.volume, airways, way, cost=cost, operator=operator, progress=progress)
    )
    write_whole(output, png, what="the image")
    print_note(f"wrote {output}")
    if as_json:
        print_json({"file": str(output), "view": FORK_SHEET, "to": way.title, "badges": source.badges.to_json()})
    return 0
