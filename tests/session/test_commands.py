"""Tests of commands and queries: each has one handler, and their limits also apply to values built in Python."""

from __future__ import annotations

import numpy as np
import pytest

from carina import commands as c
from carina.commands.value import subclasses
from carina.errors import UsageError
from carina.render import Sight
from carina.session import Session
from small_case import session_fixture


def test_every_command_and_every_query_has_exactly_one_handler():
    handlers = session_fixture().session._handlers
    assert set(handlers) == {*c.all_commands(), *subclasses(c.Query)}


@pytest.mark.parametrize("command", [c.Steer, c.GoTo, c.PlacePose, c.ResetLook, c.TakeDevice, c.SetControls, c.JoinPen])
def test_command_that_only_moves_the_tip_is_executed_by_the_pilot(command):
    session = session_fixture().session
    assert session._handlers[command] == session._core.fly


@pytest.mark.parametrize("command", [c.Place, c.SetMode, c.ToggleMode, c.DeviceGone, c.ArmPen, c.SetOperator])
def test_movement_command_that_needs_preparation_is_executed_by_its_handler(command):
    session = session_fixture().session
    assert session._handlers[command] != session._core.fly


@pytest.mark.parametrize(
    ("command", "text"),
    [
        (c.SetFov(30.0), "set_fov.fov_deg must be at least 60; found 30"),
        (c.SetFov(float("nan")), "fov_deg must be"),
        (c.SetOutline("square"), "set_outline.outline must be none, octagon or round; found 'square'"),
        (c.Place((1.0, 2.0)), "place.lps must have 3 entries; found 2"),
        (c.SetTexture("yes"), "set_texture.on must be true or false; found text"),
        (c.ChooseRoute("target-1", 3), "expected a target or a branch; found both"),
        (c.EditTree(c.PaintLumen(((0.0, 0.0, 0.0),), 0.01)), "edit_tree.edit.radius_mm must be at least 0.1"),
        (c.OpenPath(object()), "open_path contains a value that no command accepts"),
    ],
)
def test_command_value_out_of_bounds_is_refused_with_its_field_and_changes_nothing(command, text):
    fixture = session_fixture()
    fixture.open()
    before = fixture.session.snapshot()
    with pytest.raises(UsageError) as refused:
        fixture.session.do(command)
    assert text in str(refused.value)
    assert fixture.session.snapshot() == before


def test_numpy_numbers_and_points_are_accepted_in_commands():
    fixture = session_fixture()
    fixture.open()
    fixture.session.do(c.SetFov(np.float32(75.0)))
    fixture.session.do(c.SetCrosshair(fixture.session.pose_info().pose.position_lps))
    assert fixture.session.snapshot().document.look.fov_deg == 75.0
    assert isinstance(fixture.session.snapshot().sight.crosshair_lps, tuple)


def test_objects_that_are_not_commands_or_queries_are_refused_by_the_session():
    fixture = session_fixture()
    for other in (c.VoxelAt((0.0, 0.0, 0.0)), "undo", None, c.KeyFrameAdd()):
        with pytest.raises(UsageError, match="expected a command"):
            fixture.session.do(other)
    with pytest.raises(UsageError, match="expected a question"):
        fixture.session.ask(c.Undo())


def test_repr_of_a_command_is_one_line():
    assert (
        repr(c.SetOrbit(view="tree", azimuth_deg=10.0, elevation_deg=5.0))
        == "SetOrbit(azimuth_deg=10, elevation_deg=5, view='tree')"
    )
    assert repr(c.Undo()) == "Undo()"


def test_session_class_has_at_most_fifteen_public_names():
    assert len([name for name in vars(Session) if not name.startswith("_")]) <= 15


def test_history_lists_the_steps_that_can_be_undone():
    fixture = session_fixture()
    fixture.open()
    fixture.session.do(c.SetOutline("octagon"))
    fixture.session.do(c.SetFov(100.0))
    assert fixture.session.history()[-2:] == ("image outline", "field of view")


def test_commands_that_set_a_field_name_an_existing_field_and_are_undone_if_it_is_in_look():
    sets = [cls for cls in c.all_commands() if cls.sets is not None]
    assert sets
    for cls in sets:
        assert (cls.sets in c.Look.__struct_fields__) != (cls.sets in Sight.__struct_fields__), cls
        assert (cls.undo_label is not None) == (cls.sets in c.Look.__struct_fields__), cls
