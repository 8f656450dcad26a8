"""Tests that the table of views agrees with the Python types, the wire and the cells of the window."""

from __future__ import annotations

import ast
import functools
import re
from pathlib import Path
from typing import get_args

import pytest

from carina.errors import UsageError
from carina.render import (
    CELLS,
    FINDER_VIEW,
    LEAD_VIEW,
    VIEW_NAMES,
    VIEWS,
    FlatViewName,
    OrbitViewName,
    ViewName,
    view_row,
)
from carina.render.view_table import CellName, Need
from carina.volume.anatomical_planes import PLANES, Plane

REPOSITORY = Path(__file__).resolve().parents[2]


def names(**wanted):
    return {
        row.name for row in VIEWS.values() if all(getattr(row, field) in values for field, values in wanted.items())
    }


def test_each_view_cell_and_plane_has_exactly_one_row_in_the_view_table():
    assert len(VIEWS) == 13
    assert sorted(get_args(ViewName)) == sorted(VIEW_NAMES)
    assert list(get_args(CellName)) == list(CELLS)
    assert list(get_args(Plane)) == list(PLANES)


def test_types_of_flat_and_orbit_views_match_the_zoom_column_of_the_view_table():
    assert set(get_args(FlatViewName)) == names(zoom={"slice", "extent"})
    assert set(get_args(OrbitViewName)) == names(zoom={"orbit"})
    assert {row.name for row in VIEWS.values() if row.orbit is not None} == names(zoom={"orbit"})


def test_every_cell_of_the_window_has_a_view_and_a_control_for_each_of_its_views():
    for cell in CELLS.values():
        views = [row for row in VIEWS.values() if row.cell == cell.name]
        assert views
        assert (cell.chosen_by == "none") == (len(views) == 1) == (cell.next_action == "")
        if cell.chosen_by == "list":
            assert cell.list_name
            assert all(row.short for row in views)


def test_views_with_a_brush_have_an_outline_and_a_picking_plane():
    assert names(outlined={True}) == names(pick={"plane"}) == set(get_args(FlatViewName))


def test_lead_view_and_finder_view_have_their_required_properties():
    assert VIEWS[LEAD_VIEW].overlay == "airway"
    assert VIEWS[FINDER_VIEW].at_tip
    assert VIEWS[FINDER_VIEW].needs == frozenset()
    assert all(row.needs <= set(get_args(Need)) for row in VIEWS.values())


def test_unknown_view_is_refused_with_the_names_of_all_views():
    with pytest.raises(UsageError, match=r"airway, axial, .*tri-plane; found 'drone'"):
        view_row("drone")


@functools.cache
def named_strings(path: Path) -> set[str]:
    """Return the strings of a file, without comments and docstrings."""
    text = path.read_text(encoding="utf-8")
    if path.suffix != ".py":
        text = re.sub(r"/\*.*?\*/|(?<=\s)//[^\n]*", "", text, flags=re.DOTALL)
        return {quoted or template for quoted, template in re.findall(r'"([^"\n]*)"|`([^`]*)`', text)}
    tree = ast.parse(text)
    docstrings = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    constants = (node for node in ast.walk(tree) if isinstance(node, ast.Constant) and id(node) not in docstrings)
    return {node.value for node in constants if isinstance(node.value, str)}


PRODUCT = [
    path
    for folder, suffixes in (("python/carina", {".py"}), ("web/src", {".ts", ".tsx", ".css"}))
    for path in sorted((REPOSITORY / folder).rglob("*"))
    if path.suffix in suffixes and ".test." not in path.name and path.name not in {"views.ts", "messages.ts"}
    if "_web" not in path.parts
]
TREE_MESSAGE = re.compile(r"case/|server/|session/|cli/|export/|plan/|app/workstation\.ts|state/app-state\.ts")
"""Files in which ``tree`` also names the airway tree: a topic, a message, a table of the case file, an argument."""


@pytest.mark.parametrize("view", VIEW_NAMES)
def test_at_most_four_source_files_contain_the_name_of_a_view(view):
    files = [path.relative_to(REPOSITORY).as_posix() for path in PRODUCT if view in named_strings(path)]
    if view == "tree":
        files = [name for name in files if not TREE_MESSAGE.search(name)]
    assert "python/carina/render/view_table.py" in files or view in PLANES
    assert len(files) <= 4, files


def test_no_source_file_parses_the_name_of_a_view():
    for path in PRODUCT:
        found = re.findall(r"(?:startsWith|startswith|removeprefix)\(\"(?:xray|cut|tri)\b[^)]*\)", path.read_text())
        assert found == [], path
