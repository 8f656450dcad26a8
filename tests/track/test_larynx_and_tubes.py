"""Tests of scans with a neck, and with tracheal tubes: the start of the tree, and the notes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from cached_test_data import cached_airways, cached_phantom
from carina.errors import UsageError
from carina.phantom import Phantom, generate_phantom
from carina.track import Airways, find_airways

CHEST: dict[str, Any] = {"spacing_mm": 1.4, "generations": 4}
WITH_NECK = {**CHEST, "neck": True}
# Box that contains the large airways, the neck, and the air in front of the neck.
FRONT_OF_NECK_LPS = ((-110.0, -130.0, -80.0), (110.0, 70.0, 190.0))


def searched(options: dict[str, Any]) -> tuple[Phantom, Airways]:
    return cached_phantom(**options), cached_airways(**options)


def codes(airways: Airways) -> set[str]:
    return {note.code for note in airways.badges}


def begins_below_the_cricoid(made: Phantom, found: Airways) -> None:
    cricoid_z = made.truth["cricoid_lps"][2]
    slice_mm = made.volume.spacing_mm[2]
    assert 0.0 <= cricoid_z - found.root_lps[2] <= 10.0 + 0.5 * slice_mm
    assert all(branch.points[:, 2].max() <= cricoid_z for branch in found.tree.branches)
    trunk = found.tree.branches[0]
    assert trunk.points[0][2] - trunk.points[-1][2] > 0.8 * cricoid_z, "the trachea is one branch"
    lumen = found.lumen_zyx > 0
    assert (lumen & (made.lumen_zyx == 0)).sum() < 0.01 * lumen.sum()


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.soak)])
def test_tree_begins_below_the_cricoid_if_the_scan_includes_the_larynx(seed: int) -> None:
    made, found = searched({**WITH_NECK, "seed": seed})
    begins_below_the_cricoid(made, found)
    assert "track.larynx" in codes(found)
    assert any("the scan includes the larynx" in note for note in found.notes)
    upper = found.upper_airway_zyx
    assert upper is not None
    true = made.upper_airway_zyx
    assert true is not None
    assert (upper & true).sum() > 0.8 * true.sum(), "larynx and throat are stored separately from the lumen"
    assert not (upper & found.lumen_zyx).any()


def test_tracheal_tube_is_reported_with_the_height_of_its_tip() -> None:
    made, found = searched({**WITH_NECK, "seed": 1, "tube": "endotracheal"})
    begins_below_the_cricoid(made, found)
    names_the_tube(made, found, "a tracheal tube")


@pytest.mark.parametrize("seed", [9, 16])
def test_air_beside_a_tracheal_tube_is_not_a_branch_and_the_cords_are_found_from_inside_the_tube(seed: int) -> None:
    """Use seed 9, in which the tube touches the wall of the trachea, and seed 16.

    In seed 16 the lumen that is followed begins in the tube, 57 mm below the vocal cords.
    """
    begins_below_the_cricoid(*searched({**WITH_NECK, "seed": seed, "tube": "endotracheal"}))


def test_tracheostomy_is_reported_and_neither_leaks_nor_becomes_a_branch() -> None:
    made, found = searched({**WITH_NECK, "seed": 1, "tube": "tracheostomy"})
    begins_below_the_cricoid(made, found)
    names_the_tube(made, found, "a tracheostomy tube")


@pytest.mark.parametrize("seed", [1, pytest.param(4, marks=pytest.mark.soak)])
def test_air_of_a_tracheostomy_is_not_followed_out_of_the_neck_in_thin_slices(seed: int) -> None:
    options = {**WITH_NECK, "spacing_mm": (1.6, 1.6, 0.8), "noise_hu": 25.0, "box_lps": FRONT_OF_NECK_LPS}
    made, found = searched({**options, "seed": seed, "tube": "tracheostomy"})
    begins_below_the_cricoid(made, found)
    names_the_tube(made, found, "a tracheostomy tube")
    assert "track.larynx" in codes(found)


def names_the_tube(made: Phantom, found: Airways, name: str) -> None:
    [note] = [note for note in found.badges if note.code == "track.tube"]
    assert note.words.startswith(name)
    assert note.words in found.notes
    text = float(note.words.split("its tip ")[1].split(" mm")[0])
    # The fork of the found tree is up to a few mm below the phantom's fork, and one or two slices of the tube's tip are
    # blurred.
    assert abs(text - made.truth["tube"]["above_carina_mm"]) <= 4.0 + 1.5 * made.volume.spacing_mm[2]


def test_search_in_a_chest_without_larynx_and_tube_has_no_note_of_them() -> None:
    found = cached_airways(**CHEST, seed=1)
    assert not codes(found) & {"track.larynx", "track.tube"}
    assert found.upper_airway_zyx is None


def test_phantom_with_a_neck_differs_only_above_the_cricoid() -> None:
    made = cached_phantom(**WITH_NECK, seed=1)
    volume, upper = made.volume, made.upper_airway_zyx
    assert upper is not None
    cricoid = made.truth["cricoid_lps"]
    assert made.truth["branches"][0]["points"][0] == cricoid
    height = volume.to_lps(np.array([[0, 0, k] for k in range(volume.shape_zyx[0])], dtype=np.float64))[:, 2]
    above = height >= cricoid[2]
    assert not upper[~above].any()
    assert not made.lumen_zyx[above].any()
    assert not (upper & made.lumen_zyx).any()
    assert float(volume.hu_zyx[upper > 0].mean()) < -850.0


def test_phantom_refuses_a_tracheostomy_without_a_neck_and_an_unknown_tube() -> None:
    with pytest.raises(UsageError, match="tracheostomy"):
        generate_phantom(spacing_mm=6.0, generations=3, tube="tracheostomy")
    with pytest.raises(UsageError, match="endotracheal, tracheostomy"):
        generate_phantom(spacing_mm=6.0, generations=3, tube="nasal")


@pytest.mark.soak
@pytest.mark.parametrize("tube", [None, "endotracheal", "tracheostomy"])
@pytest.mark.parametrize("seed", range(20))
def test_trees_of_twenty_phantoms_with_a_neck_begin_below_the_cricoid(seed: int, tube: str | None) -> None:
    made = generate_phantom(**WITH_NECK, seed=seed, tube=tube)
    found = find_airways(made.volume)
    begins_below_the_cricoid(made, found)
    assert "track.larynx" in codes(found)
    if tube is not None:
        names_the_tube(made, found, "a tracheostomy tube" if tube == "tracheostomy" else "a tracheal tube")


@pytest.mark.soak
@pytest.mark.parametrize("options", [{"noise_hu": 30.0}, {"spacing_mm": (1.0, 1.0, 3.0)}], ids=["noise", "thick"])
@pytest.mark.parametrize("seed", range(4))
def test_trees_of_necks_in_noise_and_in_thick_slices_begin_below_the_cricoid(
    seed: int, options: dict[str, Any]
) -> None:
    made = generate_phantom(**{**WITH_NECK, **options}, seed=seed)
    begins_below_the_cricoid(made, find_airways(made.volume))


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(10))
def test_searches_in_ten_chests_without_larynx_and_tube_have_no_note_of_them(seed: int) -> None:
    found = find_airways(generate_phantom(**CHEST, seed=seed).volume)
    assert not codes(found) & {"track.larynx", "track.tube"}
