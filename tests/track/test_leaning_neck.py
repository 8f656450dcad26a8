"""Tests of the start of the tree in scans with a neck and a leaning trachea, with and without a given start."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from leaning_neck import LeaningNeck, leaning_neck
from numpy.typing import NDArray

from carina.errors import NoResultError
from carina.phantom import Phantom, generate_phantom
from carina.track import Airways, find_airways
from carina.track.find.air_upwards import dilate
from carina.track.find.trachea_search import found_trachea, whole_trachea
from carina.track.find.upper_airway import CORDS_ABOVE_CRICOID_MM, root_below_cords_mm
from carina.track.intensity_levels import air_scale
from carina.track.progress import Stages
from carina.volume import Volume

SPACING_MM = 1.6
BELOW_THE_NECK_MM = 85.0


@cache
def a_neck() -> LeaningNeck:
    return leaning_neck(1, (-25.0, 0.0), spacing_mm=SPACING_MM)


@cache
def found_in_the_neck() -> Airways:
    return find_airways(a_neck().volume)


def begins_below_the_cricoid(neck: LeaningNeck, found: Airways) -> None:
    cricoid_z = neck.cricoid_lps[2]
    assert 0.0 <= cricoid_z - found.root_lps[2] <= 10.0
    assert all(branch.points[:, 2].max() <= cricoid_z for branch in found.tree.branches)
    trunk = found.tree.branches[0]
    assert trunk.name == "Trachea"
    assert trunk.points[0][2] - trunk.points[-1][2] > 0.8 * cricoid_z, "the trachea is one branch"
    assert "track.larynx" in {note.code for note in found.badges}


def right_side(found: Airways) -> dict[str, NDArray[np.float64]]:
    """Return the end of each named branch of the right lung, LPS mm, by name."""
    return {
        branch.name: branch.points[-1]
        for branch in found.tree.branches
        if branch.name is not None and (branch.name.startswith(("R", "Right")) or branch.name == "BI")
    }


def named_as_without_the_neck(neck: LeaningNeck, found: Airways) -> None:
    names = right_side(found)
    cropped = right_side(find_airways(neck.cropped(below_mm=BELOW_THE_NECK_MM)))
    # RLL is missing in two of 20 phantoms: RML, RB6 and the basal trunk begin at one fork.
    assert {"RMB", "BI", "RUL", "RML", "RB6"} <= set(cropped)
    assert set(names) == set(cropped)
    for name, end in cropped.items():
        assert np.linalg.norm(names[name] - end) <= 5.0, name


def test_leaning_trachea_is_found_up_to_the_larynx_beside_air_in_the_oesophagus() -> None:
    neck, found = a_neck(), found_in_the_neck()
    begins_below_the_cricoid(neck, found)
    upper = found.upper_airway_zyx
    assert upper is not None
    assert not (upper & found.lumen_zyx).any()


def test_branch_names_in_a_scan_with_the_neck_equal_those_without_it() -> None:
    named_as_without_the_neck(a_neck(), found_in_the_neck())
    assert "RLL" in right_side(found_in_the_neck())


def test_tracheal_seeds_that_reach_a_main_bronchus_do_not_extend_the_trachea_into_it() -> None:
    neck, stage = a_neck(), Stages(lambda _what, _fraction: None, None)
    volume, scale = neck.volume, air_scale(neck.volume)
    trachea = found_trachea(volume, scale, stage)
    right = np.array(neck.made.truth["branches"][1]["points"])
    assert neck.made.truth["branches"][1]["name"] == "RMB"
    seeds = list(trachea.seeds)
    for point in right[right[:, 2] >= trachea.carina_lps[2] - 12.0]:
        i, j, k = (int(v) for v in np.rint(volume.to_ijk(point)))
        if k < seeds[-1][2]:
            seeds.append((i, j, k))
    assert len(seeds) > len(trachea.seeds)
    # In expiration the trachea is hardly wider than a main bronchus, which is simulated here.
    narrow = dataclasses.replace(trachea, seeds=seeds, diameters_mm=np.full(len(seeds), 12.0))
    again = whole_trachea(volume, scale, narrow, stage)
    assert again.seeds[-1][2] >= seeds[-1][2]


@pytest.mark.parametrize("size", [0.4, 0.7, 1.0, 1.2])
def test_tree_begins_within_10_mm_below_the_cricoid_at_any_height_of_the_vocal_cords(size: float) -> None:
    slice_mm = 1.0
    for cords_mm in CORDS_ABOVE_CRICOID_MM:
        below_mm = root_below_cords_mm(size) - size * cords_mm
        assert 0.0 < below_mm <= 10.0 - slice_mm


@pytest.mark.slow
def test_tree_of_a_child_with_a_leaning_trachea_begins_below_the_cricoid() -> None:
    neck = leaning_neck(2, (22.0, 10.0), scale=0.75, spacing_mm=1.2)
    begins_below_the_cricoid(neck, find_airways(neck.volume))


@pytest.mark.slow
@pytest.mark.parametrize("above_carina_mm", [15.0, 90.0])
def test_given_start_in_the_trachea_gives_the_tree_of_the_complete_trachea(above_carina_mm: float) -> None:
    neck = a_neck()
    found = find_airways(neck.volume, root_lps=neck.trachea_at(above_carina_mm))
    begins_below_the_cricoid(neck, found)
    assert right_side(found).keys() == right_side(found_in_the_neck()).keys()
    moved = any("is in the trachea: the start was moved" in note for note in found.notes)
    assert moved == (np.linalg.norm(found.root_lps - neck.trachea_at(above_carina_mm)) > 5.0)


def in_the_throat(neck: LeaningNeck) -> NDArray[np.float64]:
    upper = neck.made.upper_airway_zyx
    assert upper is not None
    voxels = np.argwhere(upper)[:, ::-1]
    highest = voxels[voxels[:, 2] >= voxels[:, 2].max() - 2]
    middle = highest[int(np.argmin(np.linalg.norm(highest - highest.mean(axis=0), axis=1)))]
    return neck.volume.to_lps(middle.astype(np.float64))


@pytest.mark.slow
@pytest.mark.parametrize("place", ["larynx", "throat"])
def test_given_start_in_the_larynx_or_the_throat_is_moved_to_the_trachea(place: str) -> None:
    neck = a_neck()
    root = neck.in_larynx if place == "larynx" else in_the_throat(neck)
    found = find_airways(neck.volume, root_lps=root)
    begins_below_the_cricoid(neck, found)
    assert any("is in the larynx or the throat: the start was moved" in note for note in found.notes)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("place", "message"),
    [
        ("gullet", "not connected to the trachea.*choose a point inside it"),
        ("air outside", "merges with the lung or lies outside the body; choose a point inside the trachea"),
        ("lung", "merges with the lung or lies outside the body; choose a point inside the trachea"),
        ("tissue", "no voxel within 5 mm is as dark as air; choose a point inside the trachea"),
    ],
)
def test_given_start_outside_the_airways_is_refused_with_a_remedy(place: str, message: str) -> None:
    neck = a_neck()
    root = {
        "gullet": neck.in_gullet(62.0),
        "air outside": np.array([120.0, -100.0, 180.0]),
        "lung": np.array([80.0, 0.0, -20.0]),
        "tissue": np.array([0.0, 45.0, 40.0]),
    }[place]
    with pytest.raises(NoResultError, match=message) as refused:
        find_airways(neck.volume, root_lps=root)
    assert refused.value.code == "track.outside-lumen"


@pytest.mark.parametrize("start", [None, "trachea", "larynx", "throat"])
def test_ct_of_head_and_neck_is_refused_because_it_shows_no_lungs(start: str | None) -> None:
    neck = a_neck()
    head = neck.cropped(above_mm=88.0)
    root = {
        None: None,
        "trachea": neck.trachea_at(95.0),
        "larynx": neck.in_larynx,
        "throat": in_the_throat(neck),
    }[start]
    with pytest.raises(NoResultError, match=r"shows no lungs.*head or neck.*open a chest CT"):
        find_airways(head, root_lps=root)


def with_a_web(made: Phantom, above_carina_mm: float) -> Volume:
    """Return the volume with a short, tight stenosis of the trachea at a height above the carina."""
    volume = made.volume
    matrix, values = volume.lps_from_ijk, volume.hu_zyx.copy()
    nk, nj, ni = volume.shape_zyx
    x, y = (matrix[a, 3] + matrix[a, a] * np.arange(n) for a, n in ((0, ni), (1, nj)))
    points = np.array(made.truth["branches"][0]["points"])
    for k in range(nk):
        z = matrix[2, 3] + matrix[2, 2] * k
        if abs(z - above_carina_mm) <= 2.0:
            middle = points[int(np.argmin(np.abs(points[:, 2] - z)))]
            off = np.hypot(x[None, :] - middle[0], y[:, None] - middle[1])
            values[k][(off > 4.2) & (off < 12.0)] = 40
    return dataclasses.replace(volume, hu_zyx=values)


def test_tree_begins_at_the_top_of_the_scan_above_a_tracheal_stenosis() -> None:
    made = generate_phantom(
        seed=4, spacing_mm=1.8, generations=4, box_lps=((-130.0, -105.0, -110.0), (130.0, 105.0, 110.0))
    )
    found = find_airways(with_a_web(made, 54.0))
    assert abs(found.root_lps[2] - 110.0) <= 2.0
    assert all(branch.points[0][2] >= branch.points[-1][2] for branch in found.tree.branches[:3])


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(20))
def test_trees_of_leaning_tracheas_begin_below_the_cricoid_and_have_the_names_found_without_the_neck(seed: int) -> None:
    random = np.random.default_rng(seed)
    lean, azimuth = random.uniform(10.0, 30.0), random.uniform(0.0, 2.0 * np.pi)
    scale = random.uniform(0.7, 1.2)
    neck = leaning_neck(
        seed,
        (float(lean * np.cos(azimuth)), float(lean * np.sin(azimuth))),
        scale=float(scale),
        spacing_mm=float(random.uniform(1.0, 1.5) * min(scale, 1.0)),
        gullet=bool(seed % 4),
    )
    found = find_airways(neck.volume)
    begins_below_the_cricoid(neck, found)
    named_as_without_the_neck(neck, found)
    starts = [neck.trachea_at(above_carina_mm) for above_carina_mm in (15.0, 50.0, 90.0)]
    for start in (*starts, neck.in_larynx, in_the_throat(neck)):
        started = find_airways(neck.volume, root_lps=start)
        begins_below_the_cricoid(neck, started)
        assert right_side(started).keys() == right_side(found).keys()


def test_dilation_by_more_than_the_size_of_a_mask_preserves_the_array_shape() -> None:
    mask = np.eye(4, 3, dtype=np.bool_)
    np.testing.assert_array_equal(dilate(mask, [(0, 4), (0, -4), (5, 0), (-5, 0), (-9, 9)]), mask)
    np.testing.assert_array_equal(dilate(mask, [(1, 0)]), mask | np.eye(4, 3, -1, dtype=np.bool_))
