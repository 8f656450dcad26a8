"""Tests of the evidence for why an airway ends: soft tissue inside its wall, a closed end, or no evidence."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from carina.track import Branch
from carina.track.find.end_evidence import find_end_evidence
from carina.track.find.straight_ends import find_straight_end
from carina.track.find.wall_profile import CrossSampler
from carina.volume import Volume

LUNG_HU, WALL_HU, AIR_HU, TISSUE_HU, CLIP_HU = -860.0, 20.0, -1000.0, 30.0, 3000.0
RADIUS_MM, WALL_MM = 3.2, 1.2
END_Z = 30.0
"""Height (mm) at which the open lumen from above ends; the airway is parallel to z at x = y = 16 mm."""


def painted(paint, spacing=(0.8, 0.8, 0.8), noise=20.0):
    """Return a CT of 32 x 32 x 60 mm; ``paint`` changes the values at points (n, 3) of a grid three times as fine."""
    fine = 3
    shape = np.ceil(np.array([32.0, 32.0, 60.0]) / spacing).astype(int)
    axes = [(np.arange(n * fine) + 0.5) / fine * s - 0.5 * s for n, s in zip(shape, spacing, strict=True)]
    values = np.empty((len(axes[2]) // fine, *shape[1::-1]))
    across = np.stack(np.meshgrid(axes[0], axes[1], indexing="ij"), axis=-1).reshape(-1, 2)
    for k in range(shape[2]):
        slab = np.zeros(shape[1::-1])
        for z in axes[2][k * fine : (k + 1) * fine]:
            points = np.column_stack([across, np.full(len(across), z)])
            plane = paint(points, np.full(len(points), LUNG_HU))
            slab += plane.reshape(shape[0], fine, shape[1], fine).mean(axis=(1, 3)).T / fine
        values[k] = slab
    values += np.random.default_rng(1).normal(0.0, noise, values.shape)
    return Volume(np.rint(values).astype(np.int16), np.diag([*spacing, 1.0]))


def tube(points, start, end, radius):
    """Return for each point whether it is in a tube with flat ends, given by its axis and radius (mm)."""
    a, b = np.array(start, dtype=float), np.array(end, dtype=float)
    length = np.linalg.norm(b - a)
    along = (points - a) @ (b - a) / length
    off = np.linalg.norm(points - a - along[:, None] * (b - a) / length, axis=1)
    return (along >= 0.0) & (along <= length) & (off <= radius)


TOP, END, BOTTOM = (16.0, 16.0, 59.0), (16.0, 16.0, END_Z), (16.0, 16.0, 8.0)
SIDES = ((8.0, 16.0, 12.0), (24.0, 16.0, 12.0))


def plugged(points, values):
    """Paint an airway whose lumen is filled with soft tissue below its end."""
    values[tube(points, TOP, BOTTOM, RADIUS_MM + WALL_MM)] = WALL_HU
    values[tube(points, END, BOTTOM, RADIUS_MM)] = TISSUE_HU
    values[tube(points, TOP, END, RADIUS_MM)] = AIR_HU
    return values


def stump(points, values):
    """Paint an airway that ends in a wall, with lung beyond."""
    values[tube(points, TOP, (16.0, 16.0, END_Z - 2.6), RADIUS_MM + WALL_MM)] = WALL_HU
    values[tube(points, TOP, END, RADIUS_MM)] = AIR_HU
    return values


def stump_with_clips(points, values):
    """Paint a closed airway with two clips at its end."""
    values = stump(points, values)
    for x in (14.0, 18.0):
        values[tube(points, (x, 13.5, END_Z - 3.5), (x, 18.5, END_Z - 3.5), 0.8)] = CLIP_HU
    return values


def forked(points, values):
    """Paint an airway that divides into two open airways with an artery between them, which the search missed."""
    for side in SIDES:
        values[tube(points, END, side, 2.0 + WALL_MM)] = WALL_HU
    values[tube(points, TOP, END, RADIUS_MM + WALL_MM)] = WALL_HU
    values[tube(points, (16.0, 16.0, END_Z - 4.0), BOTTOM, 3.0)] = TISSUE_HU
    for side in SIDES:
        values[tube(points, END, side, 2.0)] = AIR_HU
    values[tube(points, TOP, END, RADIUS_MM)] = AIR_HU
    return values


def narrowing(points, values):
    """Paint an airway that continues as an open airway of half the width."""
    values[tube(points, TOP, END, RADIUS_MM + WALL_MM)] = WALL_HU
    values[tube(points, (16.0, 16.0, END_Z + 1.0), BOTTOM, 1.6 + WALL_MM)] = WALL_HU
    values[tube(points, TOP, END, RADIUS_MM)] = AIR_HU
    values[tube(points, (16.0, 16.0, END_Z + 1.0), BOTTOM, 1.6)] = AIR_HU
    return values


BRANCH = Branch(
    1,
    0,
    (),
    1,
    None,
    "tracked",
    np.column_stack([np.full(25, 16.0), np.full(25, 16.0), np.linspace(56.0, END_Z + 1.5, 25)]),
    np.full(25, RADIUS_MM),
)


def evidence(paint, spacing):
    volume = painted(paint, spacing)
    return find_end_evidence(volume, CrossSampler(volume), BRANCH, 2.0 * RADIUS_MM)


THIN, THICK = (0.8, 0.8, 0.8), (0.7, 0.7, 3.0)


@pytest.mark.parametrize("spacing", [THIN, THICK])
def test_soft_tissue_inside_a_continuing_airway_wall_is_reported_with_its_length(spacing):
    found = evidence(plugged, spacing)
    assert found.kind == "tissue"
    assert 12.0 <= found.length_mm <= 20.0


@pytest.mark.parametrize("spacing", [THIN, THICK])
def test_end_with_a_wall_across_it_is_reported_as_closed(spacing):
    found = evidence(stump, spacing)
    assert (found.kind, found.has_clips) == ("closed", False)


def test_metal_clips_at_a_closed_airway_end_are_reported_in_thin_slices():
    found = evidence(stump_with_clips, THIN)
    assert (found.kind, found.has_clips) == ("closed", True)


@pytest.mark.parametrize("spacing", [THIN, THICK])
@pytest.mark.parametrize("paint", [forked, narrowing])
def test_end_of_a_continuing_airway_is_reported_neither_as_blocked_nor_as_closed(paint, spacing):
    assert evidence(paint, spacing) is None


WIDE_MM, FAINT_WALL_MM = 4.6, 1.2
"""Radius of a wide bronchus, and thickness of a wall that is blurred in slices of 3 mm; both in mm."""
WIDE_BRANCH = dataclasses.replace(BRANCH, radius=np.full(25, WIDE_MM))


def wide_stump(lung_hu=LUNG_HU, ahead=None):
    """Return a painter of a wide bronchus that ends in a thin wall.

    ``ahead`` is the radius of an airway beyond the wall, mm; None paints no such airway.
    """

    def paint(points, values):
        values[:] = lung_hu
        values[tube(points, TOP, (16.0, 16.0, END_Z - FAINT_WALL_MM), WIDE_MM + FAINT_WALL_MM)] = WALL_HU
        if ahead is not None:
            values[tube(points, END, BOTTOM, ahead + FAINT_WALL_MM)] = WALL_HU
            values[tube(points, (16.0, 16.0, END_Z + 1.0), BOTTOM, ahead)] = AIR_HU
        values[tube(points, TOP, END, WIDE_MM)] = AIR_HU
        return values

    return paint


def wide_evidence(paint, spacing):
    volume = painted(paint, spacing)
    return find_end_evidence(volume, CrossSampler(volume), WIDE_BRANCH, 2.0 * WIDE_MM)


@pytest.mark.parametrize("spacing", [THIN, THICK])
def test_wide_bronchus_with_a_thin_wall_across_its_end_is_reported_as_closed(spacing):
    assert wide_evidence(wide_stump(), spacing).kind == "closed"


@pytest.mark.parametrize("spacing", [THIN, THICK])
@pytest.mark.parametrize("radius", [1.5, 2.5])
def test_wide_bronchus_with_an_airway_beyond_its_end_wall_is_not_reported_as_closed(radius, spacing):
    assert wide_evidence(wide_stump(ahead=radius), spacing) is None


def test_wide_bronchus_whose_end_wall_is_as_dense_as_lung_is_not_reported_as_closed():
    def no_wall(points, values):
        values[:] = -680.0
        values[tube(points, TOP, END, WIDE_MM)] = AIR_HU
        return values

    assert wide_evidence(no_wall, THICK) is None


NARROW_MM, TURN_Z = 2.4, 33.0
"""Radius of an airway that leaves a wide bronchus sideways, and height at which it leaves the bronchus; both in mm."""
ASIDE = (28.0, 16.0, 19.0)


def turned(ahead):
    """Return a painter of a wide bronchus that a narrow airway leaves sideways above its end.

    ``ahead`` is the height of the wide bronchus's end, None if the wide bronchus continues straight on.
    """

    def paint(points, values):
        end = BOTTOM if ahead is None else (16.0, 16.0, ahead)
        start = (16.0, 16.0, TURN_Z)
        values[tube(points, TOP, (*end[:2], end[2] - 1.2), WIDE_MM + 1.2)] = WALL_HU
        values[tube(points, start, ASIDE, NARROW_MM + 1.2)] = WALL_HU
        values[tube(points, TOP, end, WIDE_MM)] = AIR_HU
        values[tube(points, start, ASIDE, NARROW_MM)] = AIR_HU
        return values

    return paint


def turning_branch(narrow_mm=NARROW_MM):
    """Return the branch that a search finds in the CT of `turned`.

    It consists of the wide bronchus and the narrow airway, without a fork.
    """
    wide = np.linspace([16.0, 16.0, 56.0], [16.0, 16.0, TURN_Z], 24)
    narrow = np.linspace([16.0, 16.0, TURN_Z], ASIDE, 19)[1:]
    radius = np.concatenate([np.full(24, WIDE_MM), np.full(18, narrow_mm)])
    return Branch(1, 0, (), 2, "BI", "tracked", np.concatenate([wide, narrow]), radius)


def straight_end(paint, spacing, branch):
    return find_straight_end(CrossSampler(painted(paint, spacing)), branch)


@pytest.mark.parametrize("spacing", [THIN, THICK])
def test_wide_bronchus_that_ends_beside_a_narrow_side_branch_is_a_closed_end(spacing):
    found = straight_end(turned(26.0), spacing, turning_branch())
    assert found.width_mm == pytest.approx(2.0 * WIDE_MM)
    assert found.axis @ [0.0, 0.0, -1.0] > 0.99
    assert np.linalg.norm(found.lps - [16.0, 16.0, 30.0]) < 4.0


@pytest.mark.parametrize("spacing", [THIN, THICK])
def test_wide_bronchus_that_continues_beside_a_narrow_side_branch_is_not_a_closed_end(spacing):
    assert straight_end(turned(None), spacing, turning_branch()) is None


def test_airway_that_turns_without_narrowing_is_not_a_closed_end():
    assert straight_end(turned(26.0), THIN, turning_branch(narrow_mm=0.8 * WIDE_MM)) is None
