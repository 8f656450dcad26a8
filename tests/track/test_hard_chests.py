"""Tests of chests that are difficult to segment, because of their surroundings, their contents or missing parts."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from cached_test_data import cached_phantom, found_airways
from carina.errors import NoResultError
from carina.phantom import Phantom
from carina.track import find_airways
from carina.volume.model import Volume

SPACING_MM = 1.3


@pytest.fixture(scope="module")
def made() -> Phantom:
    return cached_phantom(seed=5, spacing_mm=SPACING_MM, generations=4, noise_hu=20.0)


def places(volume: Volume):
    nz, ny, nx = volume.shape_zyx
    origin, step = volume.lps_from_ijk[:3, 3], np.diag(volume.lps_from_ijk)[:3]
    x = origin[0] + step[0] * np.arange(nx)[None, None, :]
    y = origin[1] + step[1] * np.arange(ny)[None, :, None]
    z = origin[2] + step[2] * np.arange(nz)[:, None, None]
    return x, y, z


def arms_and_table(values, made):
    x, y, z = places(made.volume)
    outside = values < -900
    for side in (-1.0, 1.0):
        off = np.hypot(x - side * 158.0, y - 20.0) + 0.0 * z
        # The arm contains a bone with marrow; the air between arm and chest stays air.
        values[outside & (off < 13.0)] = 50
        values[outside & (off < 7.0)] = 600
        values[outside & (off < 3.0)] = -80
    table = np.broadcast_to((y > 112.0) & (y < 118.0), values.shape)
    values[table & (values < -900)] = -300


def padded_circle(values, made):
    x, y, z = places(made.volume)
    values[np.hypot(x, y) + 0.0 * z > 165.0] = -2048


def consolidated(values, made):
    x, _, z = places(made.volume)
    lung = (values > -950) & (values < -600) & (made.lumen_zyx == 0)
    values[lung & (x < -5.0) & (z < -40.0)] += 860


def noise_60(values, made):
    values += np.random.default_rng(2).normal(0.0, 56.0, values.shape).astype(np.int16)


def emphysema(values, made):
    rng = np.random.default_rng(3)
    coarse = rng.normal(size=tuple(-(-n // 4) for n in values.shape))
    blobs = np.kron(coarse, np.ones((4, 4, 4)))[: values.shape[0], : values.shape[1], : values.shape[2]]
    lung = (values > -950) & (values < -700) & (made.lumen_zyx == 0)
    values[lung & (blobs > 1.0)] = -965


def tube_in_the_trachea(values, made):
    # A plastic tube with air inside, from the top of the scan to 30 mm above the carina.
    x, y, z = places(made.volume)
    trunk = made.truth["branches"][0]
    points = np.array(trunk["points"])
    for n, height in enumerate(z[:, 0, 0]):
        if height > 30.0:
            middle = points[np.argmin(np.abs(points[:, 2] - height))]
            off = np.hypot(x[0] - middle[0], y[0] - middle[1])
            values[n][(off > 3.6) & (off < 5.4)] = 180


HARD: list[Callable] = [
    arms_and_table,
    padded_circle,
    consolidated,
    noise_60,
    emphysema,
    tube_in_the_trachea,
]


def share_found(airways, made, generations):
    """Return the share of the true centreline, up to a generation, whose voxel or a neighbouring voxel was found."""
    lumen = np.pad(airways.lumen_zyx, 1)
    grown = np.zeros_like(lumen)
    for axis in range(3):
        for by in (-1, 0, 1):
            grown |= np.roll(lumen, by, axis)
    hits = []
    for row in made.truth["branches"]:
        if row["generation"] <= generations:
            ijk = np.floor(made.volume.to_ijk(np.array(row["points"])) + 0.5).astype(int)
            ijk = np.clip(ijk, 0, np.array(made.volume.shape_zyx[::-1]) - 1) + 1
            hits.append(grown[ijk[:, 2], ijk[:, 1], ijk[:, 0]])
    return float(np.concatenate(hits).mean())


@pytest.mark.slow
@pytest.mark.parametrize("harder", HARD, ids=lambda harder: harder.__name__)
def test_search_in_a_difficult_chest_finds_its_airways_and_no_false_ones(made, harder):
    values = np.array(made.volume.hu_zyx)
    harder(values, made)
    airways = find_airways(Volume(values, made.volume.lps_from_ijk))
    found, true = airways.lumen_zyx != 0, made.lumen_zyx != 0
    top = np.array(made.truth["branches"][0]["points"][0])
    # The root is in the first centimetres of the trachea, within its radius of the axis.
    assert np.linalg.norm((airways.root_lps - top)[:2]) < 9.0
    assert airways.root_lps[2] > top[2] - 25.0
    outside = found & ~true
    if harder is tube_in_the_trachea:
        # No branch ends inside the plastic tube, which the trachea encloses.
        assert not any(b.points[-1][2] > 20.0 and b.parent is not None for b in airways.tree.branches)
    assert outside.sum() <= 0.02 * found.sum()
    assert share_found(airways, made, 3) > 0.95
    assert {"Trachea", "RMB", "LMB"} <= set(airways.tree.names)


@pytest.mark.slow
@pytest.mark.parametrize("tilt_deg", [-25.0, 25.0])
def test_lumen_of_a_tilted_chest_overlaps_that_of_the_straight_chest(made, tilt_deg):
    t = np.radians(tilt_deg)
    turn = np.eye(4)
    turn[1:3, 1:3] = [[np.cos(t), -np.sin(t)], [np.sin(t), np.cos(t)]]
    straight = found_airways(made.volume)
    tilted = find_airways(Volume(made.volume.hu_zyx, turn @ made.volume.lps_from_ijk))
    moved = turn[:3, :3] @ straight.root_lps
    assert np.linalg.norm(tilted.root_lps - moved) < 15.0
    both = (straight.lumen_zyx != 0) & (tilted.lumen_zyx != 0)
    assert both.sum() > 0.97 * max((straight.lumen_zyx != 0).sum(), (tilted.lumen_zyx != 0).sum())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("side", "tilt_deg"), [("x", -30.0), pytest.param("x", 30.0, marks=pytest.mark.soak), ("y", -35.0), ("y", 35.0)]
)
def test_bent_neck_bends_the_found_trachea_and_changes_no_other_airway(made, side, tilt_deg):
    # Above the middle of the trachea each slice is shifted farther sideways than the slice below, as in a bent neck.
    _, _, z = places(made.volume)
    from_mm, axis = 45.0, {"x": 2, "y": 1}[side]
    aside_mm = np.tan(np.radians(tilt_deg)) * np.maximum(z[:, 0, 0] - from_mm, 0.0)
    bent, lumen = np.array(made.volume.hu_zyx), np.array(made.lumen_zyx != 0)
    for n, by in enumerate(np.rint(aside_mm / SPACING_MM).astype(int)):
        bent[n], lumen[n] = (np.roll(slices[n], by, axis - 1) for slices in (bent, lumen))
    airways = find_airways(Volume(bent, made.volume.lps_from_ijk))
    top = np.array(made.truth["branches"][0]["points"][0])
    top["xy".index(side)] += np.interp(top[2], z[:, 0, 0], aside_mm)
    assert np.linalg.norm((airways.root_lps - top)[:2]) < 9.0
    assert airways.root_lps[2] > top[2] - 25.0
    found = airways.lumen_zyx != 0
    assert (found & ~lumen).sum() <= 0.02 * found.sum()
    height = np.arange(len(z))[z[:, 0, 0] > from_mm]
    # The found lumen ends before the wall, so the bent part must contain as much of it as the straight part.
    assert found[height].sum() > 0.8 * lumen[height].sum()
    assert share_found(airways, made, 3) > 0.85
    assert {"Trachea", "RMB", "LMB"} <= set(airways.tree.names)


@pytest.mark.slow
def test_part_of_the_trachea_is_sufficient_for_the_search_and_a_chest_without_airways_is_refused(made):
    x, _, z = places(made.volume)
    heights = z[:, 0, 0]
    low = Volume(np.ascontiguousarray(made.volume.hu_zyx[heights < 26.0]), made.volume.lps_from_ijk)
    airways = find_airways(low)
    assert abs(airways.root_lps[2] - heights[heights < 26.0].max()) < 6.0
    # The chest without airways has lumen and walls replaced by lung and tissue.
    without = np.array(made.volume.hu_zyx)
    grown = made.lumen_zyx != 0
    for _ in range(3):
        for axis in range(3):
            grown |= np.roll(grown, 1, axis) | np.roll(grown, -1, axis)
    without[grown] = np.where(np.broadcast_to(np.abs(x) > 25.0, grown.shape)[grown], -860, 40)
    with pytest.raises(NoResultError, match="no trachea") as caught:
        find_airways(Volume(without, made.volume.lps_from_ijk))
    assert caught.value.exit_code == 4
    assert "root" in str(caught.value)


@pytest.fixture(scope="module", params=[1, *(pytest.param(seed, marks=pytest.mark.soak) for seed in (2, 3))])
def any_made(request) -> Phantom:
    return cached_phantom(seed=request.param, spacing_mm=SPACING_MM, generations=4, noise_hu=20.0)


def cut_above(made: Phantom, height_mm: float) -> Volume:
    """Return the chest below ``height_mm`` above the carina."""
    carina = made.truth["branches"][0]["points"][-1]
    matrix = made.volume.lps_from_ijk
    heights = places(made.volume)[2][:, 0, 0]
    assert matrix[2, 2] > 0.0
    keep = heights < carina[2] + height_mm
    return Volume(np.ascontiguousarray(made.volume.hu_zyx[keep]), matrix)


@pytest.mark.slow
@pytest.mark.parametrize("below_mm", [10.0, 20.0, 35.0, 60.0])
def test_chest_cropped_below_the_carina_is_refused(any_made, below_mm):
    with pytest.raises(NoResultError, match="no trachea was found") as caught:
        find_airways(cut_above(any_made, -below_mm))
    assert caught.value.exit_code == 4
    # The message contains the reason and the remedy.
    assert "bronch" in str(caught.value)
    assert "point in the" in str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize("above_mm", [12.0, 30.0])
def test_trachea_is_found_in_a_chest_cropped_above_the_carina(any_made, above_mm):
    volume = cut_above(any_made, above_mm)
    airways = find_airways(volume)
    assert abs(airways.root_lps[2] - above_mm) < 8.0
    assert abs(airways.root_lps[0]) < 10.0
    assert {"RMB", "LMB"} <= set(airways.tree.names)


@pytest.mark.slow
@pytest.mark.parametrize("below", [20.0, 35.0])
def test_chest_cropped_below_the_carina_is_tracked_from_a_given_root(any_made, below):
    row = next(
        row
        for row in any_made.truth["branches"]
        if row["generation"] >= 1 and row["points"][0][2] > -below - 4.0 > row["points"][-1][2]
    )
    points = np.array(row["points"])
    root = points[np.argmin(np.abs(points[:, 2] + below + 4.0))]
    airways = find_airways(cut_above(any_made, -below), root_lps=root)
    assert np.linalg.norm(airways.root_lps - root) < 5.0
    assert not any("in the trachea" in note for note in airways.notes)
    assert len(airways.tree) >= 2
