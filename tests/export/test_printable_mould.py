"""Tests of the printable mould: watertight parts, thickness of the cast, pins, opening, and a printer's limits."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest
import trimesh

import carina
from cached_test_data import SMALL_CHEST, cached_airways, cached_phantom
from carina.errors import UsageError
from carina.export import printable_mould, write_mesh
from carina.export.printable_mould import CLEARANCE_MM, MOULD_PARTS, PIN_LENGTH_MM, mould_branches
from carina.export.printable_phantom import PrintedLumen
from carina_bench.printed_walls import distances_to_triangles

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("shared_lumen")]
WALL_MM = 2.0


@pytest.fixture(scope="module")
def chest():
    return cached_phantom(**SMALL_CHEST).volume, cached_airways(**SMALL_CHEST)


@pytest.fixture(scope="module")
def made(chest):
    return printable_mould(*chest, wall_mm=WALL_MM, progress=False)


@pytest.mark.parametrize("part", MOULD_PARTS)
def test_part_is_watertight_for_other_software(tmp_path, made, part):
    path = write_mesh(tmp_path / f"{part}.stl", made.parts[part], contents=f"mould of the airway wall, {part}")
    found = trimesh.load(path)
    assert found.is_watertight
    assert found.is_winding_consistent
    assert found.volume > 0.0


def test_space_between_core_and_halves_has_the_thickness_of_the_cast(chest, made):
    lumen = PrintedLumen.of(*chest, None, branches=frozenset(made.branches))
    vertices = made.core.vertices_lps
    # Handle and supports fill their beds.
    on_lumen = np.abs(lumen.field.distance_mm(vertices)) < 0.1
    on_lumen &= np.linalg.norm(vertices - chest[1].tree.root.points[0], axis=1) > 25.0
    places = vertices[on_lumen]
    places = places[np.random.default_rng(1).permutation(len(places))[:1500]]
    corners = np.concatenate([one.vertices_lps[one.triangles] for one in (made.front, made.back)])
    found = distances_to_triangles(places, corners)
    assert np.median(found) == pytest.approx(WALL_MM, abs=0.1)
    # The beds of the supports are the only places at which the halves are nearer.
    assert (found > WALL_MM - 0.2).mean() > 0.9


def test_halves_meet_without_overlap_and_pins_fit_their_holes(made):
    front, back = made.front, made.back
    low, high = front.vertices_lps.min(axis=0), front.vertices_lps.max(axis=0)
    both_low = np.minimum(low, back.vertices_lps.min(axis=0))
    for x in (both_low[0] + 5.0, high[0] - 5.0):
        near = np.hypot(back.vertices_lps[:, 0] - x, back.vertices_lps[:, 2] - (high[2] - 5.0)) < 3.05
        pin = back.vertices_lps[near]
        top = pin[pin[:, 1] < pin[:, 1].min() + PIN_LENGTH_MM - 1.0]
        assert len(top) > 50
        gaps = distances_to_triangles(top, front.vertices_lps[front.triangles])
        assert gaps.min() > 0.5 * CLEARANCE_MM
        assert gaps.max() < 3.0 * CLEARANCE_MM


@pytest.mark.parametrize(("part", "sign"), [("front", 1.0), ("back", -1.0)])
def test_half_opens_along_y_without_enclosing_the_cast(made, part, sign):
    mesh = made.parts[part]
    corners = mesh.vertices_lps[mesh.triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(across, axis=1)
    middles = corners.mean(axis=1)
    low, high = mesh.vertices_lps.min(axis=0), mesh.vertices_lps.max(axis=0)
    # The outside of the block, and its margin with the pins, are left out.
    inner = ((middles[:, [0, 2]] > low[[0, 2]] + 9.0) & (middles[:, [0, 2]] < high[[0, 2]] - 9.0)).all(axis=1)
    inner &= (middles[:, 1] > low[1] + 1.0) & (middles[:, 1] < high[1] - 1.0)
    faces_away = sign * across[:, 1] < -0.2 * area
    assert area[inner & faces_away].sum() < 0.05 * area[inner].sum()


def test_mould_contains_the_central_airways(chest, made):
    tree = chest[1].tree
    names = {tree.branch(number).name for number in made.branches}
    assert {"Trachea", "RMB", "LMB"} <= names
    assert made.num_left_out == len(tree.branches) - len(made.branches)
    assert {tree.branch(number).parent for number in made.branches} - {None} <= set(made.branches)
    assert "Trachea" in made.names
    wide = mould_branches(tree, WALL_MM, 6.0)
    assert set(wide) < set(made.branches)


def test_limits_of_the_printer_are_checked_with_a_remedy(chest, monkeypatch):
    with pytest.raises(UsageError, match="a larger build volume") as refused:
        printable_mould(*chest, build_mm=(90.0, 80.0, 60.0), progress=False)
    assert refused.value.code == "print.too-large"
    # No trachea of a chest is too thin for the limits of the option.
    monkeypatch.setattr(sys.modules["carina.export.printable_mould"], "LEAST_RADIUS_MM", 20.0)
    with pytest.raises(UsageError, match="a finer printer") as refused:
        printable_mould(*chest, wall_mm=2.0, build_mm=(900.0,) * 3, progress=False)
    assert refused.value.code == "print.wall"


def test_facts_are_plain_json(made):
    found = json.loads(json.dumps(made.to_json()))
    assert set(found["parts"]) == set(MOULD_PARTS)
    assert all(one["volume_ml"] > 0.0 for one in found["parts"].values())
    assert carina.export.PrintableMould.__doc__
