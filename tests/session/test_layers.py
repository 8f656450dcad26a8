"""Tests of layers (structures around targets, drawn over slices): position at every zoom, computation and failure."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

import carina
from cached_test_data import cached_phantom
from carina.commands import LungsOf, MapLungs, MapReach
from carina.errors import CancelledError, NoResultError, UsageError
from carina.plan import Nodule
from carina.plan.lungs.lung_map import LungMap, MappedMask, _within, map_lungs
from carina.session.scene.layer_lines import ShownLayers
from small_case import session_fixture

MATRIX = np.diag([2.0, 2.0, 2.0, 1.0])
MATRIX[:3, 3] = (-10.0, 30.0, -200.0)
NUM = (20, 24, 28)


def ball(middle_ijk: tuple[float, float, float], radius: float) -> np.ndarray:
    k, j, i = np.indices(NUM)
    return sum((a - b) ** 2 for a, b in zip((i, j, k), middle_ijk, strict=True)) < radius**2


def axial(mm_per_px: float, column: float = 0.0, row: float = 0.0, z: float = -180.0) -> np.ndarray:
    """Return the matrix of an axial slice whose first pixel is at the corner of the masks, moved by whole pixels."""
    matrix = np.diag([mm_per_px, mm_per_px, 1.0, 1.0])
    matrix[:3, 3] = (-10.0 + mm_per_px * column, 30.0 + mm_per_px * row, z)
    return matrix


def drawn(lines) -> np.ndarray:
    """Return the points of the lines in pixels of the picture, (n, 2)."""
    data, points = lines.data, []
    while data:
        count = int.from_bytes(data[:2], "little")
        points.append(np.frombuffer(data, "<u2", 2 * count, 2).reshape(-1, 2) / 16.0)
        data = data[2 + 4 * count :]
    found = np.concatenate(points)
    a, b, c, d, e, f = lines.pixel_from_line
    return found @ np.array([[a, b], [c, d]]) + (e, f)


@pytest.mark.parametrize("place", [axial(1.0), axial(0.3, 40.0, -25.0), axial(5.0)])
def test_mask_outline_is_half_way_between_voxels_at_every_zoom(place):
    lungs = LungMap(lobes=(("RUL", MappedMask.placed(ball((10, 12, 10), 6.0), MATRIX)),))
    (lines,) = ShownLayers(lungs, None).lines(place, ("lobes",))
    assert (lines.layer, lines.part, lines.complete) == ("lobes", "RUL", True)
    points = np.column_stack([drawn(lines), np.zeros(len(drawn(lines))), np.ones(len(drawn(lines)))]) @ place.T
    away = np.linalg.norm(points[:, :3] - (MATRIX @ (10, 12, 10, 1))[:3], axis=1)
    # The tolerance is half of a voxel's diagonal plus the rounding of the lines.
    assert away.min() > 12.0 - 1.8
    assert away.max() < 12.0 + 1.8
    # The outline is closed even if the picture shows only a part of it.
    assert np.allclose(drawn(lines)[0], drawn(lines)[-1])


def test_plane_that_does_not_cut_a_mask_has_no_outline_and_hidden_layers_are_omitted():
    shown = ShownLayers(LungMap(fissures=MappedMask.placed(ball((10, 12, 10), 3.0), MATRIX)), None)
    assert shown.names == ("fissures",)
    assert shown.lines(axial(1.0, z=-100.0), ("fissures",)) == ()
    assert shown.lines(axial(1.0), ("vessels", "lobes")) == ()
    assert len(shown.lines(axial(1.0), ("fissures",))) == 1


def test_target_voxels_are_omitted_from_the_vessel_layer():
    vessels = MappedMask.placed(ball((6, 12, 10), 3.0) | ball((14, 12, 10), 3.0), MATRIX)
    inside = np.ones((9, 9, 9), dtype=bool)
    matrix = np.diag([2.0, 2.0, 2.0, 1.0])
    matrix[:3, 3] = MATRIX[:3, 3] + 2.0 * np.array([10, 8, 6])
    centre = tuple(float(v) for v in MATRIX[:3, 3] + 2.0 * np.array([14, 12, 10]))
    nodule = Nodule(centre, "solid", 500.0, 10.0, 9.0, 9.0, 0.5, 500.0, 30.0, (), inside, matrix)
    lungs = LungMap(vessels=vessels)
    both, (one,) = ((ShownLayers(lungs, None, n).lines(axial(1.0), ("vessels",))) for n in ((), (nodule,)))
    assert drawn(both[0])[:, 0].max() > 28.0
    assert drawn(one)[:, 0].max() < 20.0
    # Only the drawn layer omits the target's voxels; the vessel mask still contains them.
    assert vessels.inside_zyx[10, 12, 14]


def fixture_with(**parts):
    made = session_fixture(wall_field=lambda *_given, **_options: object(), **parts)
    made.open()
    return made


BALL = MappedMask.placed(ball((10, 12, 10), 6.0), MATRIX)


def test_layers_are_computed_on_request_and_vessels_are_shown_before_the_lobes():
    seen = []

    def slow(_volume, _airways, _wall, *, progress, found):
        progress("looking for vessels", 0.1)
        found(LungMap(vessels=BALL))
        seen.append(session.ask(LungsOf()))
        assert session.scene().layers.names == ("vessels",)
        return LungMap(vessels=BALL, lobes=(("RUL", BALL),))

    fixture = fixture_with(map_lungs=slow)
    session = fixture.session
    fixture.background.run_all()
    assert session.scene().layers is None
    assert session.ask(LungsOf()).standing == "unwanted"
    key = session.scene().key("axial")
    session.do(MapLungs())
    assert session.ask(LungsOf()).standing == "making"
    fixture.background.run_all()
    assert seen[0].standing == "making"
    assert seen[0].lungs.vessels is BALL
    info = session.ask(LungsOf())
    assert info.standing == "had"
    assert [mark.station for mark in info.stations][:2] == ["4R", "4L"]
    assert session.scene().layers.names == ("lobes", "vessels")
    assert session.scene().key("axial") != key


def test_layers_computed_for_other_airways_are_not_shown_and_reported_as_outdated():
    fixture = fixture_with(map_lungs=lambda *_given, **_options: LungMap(vessels=BALL))
    session = fixture.session
    session.do(MapLungs())
    fixture.background.run_all()
    case = session._core.case
    airways = case.document.airways
    changed = replace(case.document, airways=type(airways)(**vars(airways)))
    with session._core.lock:
        session._core.change(case, "other airways", changed)
    info = session.ask(LungsOf())
    assert (info.lungs, info.standing, info.outdated, info.stations) == (None, "unwanted", True, ())
    assert session.scene().layers is None
    session.undo()
    assert session.scene().layers.names == ("vessels",)
    assert not session.ask(LungsOf()).outdated


def test_failed_computation_of_layers_states_its_reason_and_can_be_retried():
    error = [NoResultError("no lung was found", code="plan.no_lung"), CancelledError("stopped"), None]

    def make(*_given, **_options):
        problem = error.pop(0)
        if problem is not None:
            raise problem
        return LungMap(vessels=BALL)

    fixture = fixture_with(map_lungs=make)
    for standing, problem in (("failed", "no lung was found"), ("stopped", None), ("had", None)):
        fixture.session.do(MapLungs())
        fixture.background.run_all()
        info = fixture.session.ask(LungsOf())
        assert (info.standing, info.problem) == (standing, problem)


def test_reach_layer_is_that_of_the_last_requested_instrument():
    calls = []

    def make(_volume, _airways, *, scope, tool, wall, progress, cancel):
        calls.append((scope, tool))
        raise NoResultError(f"nothing for {scope}")

    fixture = fixture_with(reach_atlas=make)
    with pytest.raises(UsageError):
        fixture.session.do(MapReach("no-such-scope"))
    fixture.session.do(MapReach("ultrathin"))
    fixture.background.run_all()
    fixture.session.do(MapReach("thin", "forceps"))
    fixture.background.run_all()
    assert calls == [("ultrathin", "needle-21g"), ("thin", "forceps")]
    assert fixture.session.ask(LungsOf()).reach_problem == "nothing for thin"


def test_layers_are_not_computed_without_airways():
    def none(*_given, **_options):
        raise NoResultError("no trachea")

    fixture = fixture_with(find_airways=none)
    with pytest.raises(NoResultError, match="segment the airways first"):
        fixture.session.do(MapLungs())


def test_voxels_at_the_rim_of_the_lungs_are_excluded_from_the_vessel_layer():
    known = np.zeros((9, 10, 11), dtype=bool)
    known[1:8, :, 2:10] = True
    inner = _within(known, 2)
    assert inner[3:6, 2:8, 4:8].all()
    assert inner.sum() == 3 * 6 * 4


@pytest.mark.slow
def test_phantom_lungs_have_vessel_and_lobe_layers_and_every_stage_can_be_cancelled():
    made = cached_phantom(seed=4, spacing_mm=3.0, generations=4)
    airways = carina.find_airways(made.volume)
    wall = carina.track.wall_field(made.volume, airways)
    reported, early = [], []
    lungs = map_lungs(
        made.volume, airways, wall, progress=lambda what, share: reported.append((what, share)), found=early.append
    )
    assert [made.vessel_tree is None for made in early] == [True, False]
    assert early[-1].lobes == ()
    assert early[0].vessels is lungs.vessels
    assert 20.0 < lungs.vessels.ml < 1000.0
    assert not (lungs.sure_vessels.inside_zyx & ~lungs.vessels.inside_zyx).any()
    assert {name for name, _ in lungs.lobes} >= {"RUL", "RLL", "LUL", "LLL"}
    assert lungs.vessel_tree.length_mm > 1000.0
    tree, vessels = lungs.vessel_tree, lungs.vessels
    assert all(branch.parent is None or branch.parent < n for n, branch in enumerate(tree.branches))
    points = np.concatenate([branch.points_lps for branch in tree.branches])
    i, j, k = np.rint((points - vessels.first_lps) / vessels.spacing_mm).astype(int).T
    # Lines are smoothed, so a few points at a bend are beside the voxels of their vessel.
    assert vessels.inside_zyx[k, j, i].mean() > 0.85
    shares = [share for _, share in reported]
    assert shares == sorted(shares)
    # Every stage checks several times, so that a stop does not wait for the end of the stage.
    looks = Counter(what for what, _ in reported)
    assert looks["looking for vessels"] >= 8
    assert looks["following the vessels"] >= 3
    assert min(count for what, count in looks.items() if what != "finding the lungs") >= 3

    def stop(what, _share):
        if "vessels" in what:
            raise CancelledError("stopped")

    with pytest.raises(CancelledError):
        map_lungs(made.volume, airways, wall, progress=stop)
