"""The table of views agrees with what is spelled out beside it: the types, the wire, the cells of the window."""

from __future__ import annotations

import dataclasses
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
from carina.server import messages as wire
from carina.volume.planes import PLANES, Plane


def names(**wanted):
    return {
        row.name for row in VIEWS.values() if all(getattr(row, field) in values for field, values in wanted.items())
    }


def test_each_view_cell_and_plane_of_the_types_has_one_row_and_no_other_has():
    assert len(VIEWS) == 13
    assert sorted(get_args(ViewName)) == sorted(VIEW_NAMES)
    assert list(get_args(CellName)) == list(CELLS)
    assert list(get_args(Plane)) == list(PLANES)


def test_the_wire_knows_the_scale_and_the_camera_of_each_view_that_has_one():
    assert set(get_args(FlatViewName)) == names(zoom={"slice", "extent"})
    assert set(get_args(OrbitViewName)) == names(zoom={"orbit"})
    scales = {row.scale_field for row in VIEWS.values()} - {None}
    assert {field.name for field in dataclasses.fields(wire.Zoom)} == scales
    cameras = {f"orbit_{VIEWS[name].field}" for name in get_args(OrbitViewName)}
    assert cameras <= {field.name for field in dataclasses.fields(wire.State)}


def test_every_cell_has_a_view_and_a_way_to_bring_each_of_them():
    for cell in CELLS.values():
        views = [row for row in VIEWS.values() if row.cell == cell.name]
        assert views
        assert (cell.chosen_by == "none") == (len(views) == 1) == (cell.next_action == "")
        if cell.chosen_by == "list":
            assert cell.list_name
            assert all(row.short for row in views)


def test_a_brush_needs_an_outline_and_a_plane_the_same_views():
    assert names(outlined={True}) == names(pick={"plane"}) == set(get_args(FlatViewName))


def test_the_views_with_a_part_to_play_can_play_it():
    assert VIEWS[LEAD_VIEW].overlay == "airway"
    assert VIEWS[FINDER_VIEW].at_tip
    assert VIEWS[FINDER_VIEW].needs == frozenset()
    assert all(row.needs <= set(get_args(Need)) for row in VIEWS.values())


def test_an_unknown_view_is_refused_with_the_names_of_all():
    with pytest.raises(UsageError, match=r"airway, axial, .*tri-plane; found 'drone'"):
        view_row("drone")
