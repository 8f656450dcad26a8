"""Tests that copied and pickled airways, also in another process, give the same results."""

from __future__ import annotations

import copy
import dataclasses
import io
import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from edit_case import assert_same_tree, edit_case

import carina
from carina.errors import DiskError, NoEvidenceError
from carina.track import CutBranch, MoveRoot, PathTracker, RenameBranch, measure_tree
from carina.volume import MaskLabel, MaskLabelError
from carina.volume.sparse_mask import PackedMask

IN_ANOTHER_PROCESS = """
import pickle, sys
import carina
from carina.track import CutBranch, measure_tree
with open(sys.argv[1], "rb") as file:
    volume, airways, target = pickle.load(file)
edited = carina.edit_airways(volume, airways, CutBranch(airways.tree.tips()[-1].id))
path = airways.tracker.path_to(target)
with open(sys.argv[2], "wb") as file:
    pickle.dump((edited, path, measure_tree(volume, airways).to_json()), file)
"""


def by_pickle(value: Any) -> Any:
    return pickle.loads(pickle.dumps(value))


def by_buffers(value: Any) -> Any:
    """Return a copy of the value pickled as Ray stores objects: arrays outside the pickle, mapped read-only."""
    buffers: list[pickle.PickleBuffer] = []
    data = pickle.dumps(value, protocol=5, buffer_callback=buffers.append)
    return pickle.loads(data, buffers=[bytes(one.raw()) for one in buffers])


def by_mapped_files(value: Any, folder: Path) -> Any:
    """Return a copy of the value passed as joblib passes arguments: large arrays are files that the receiver maps."""

    class Mapping(pickle.Pickler):
        num_files = 0

        def reducer_override(self, value: Any) -> Any:
            if type(value) is not np.ndarray or value.nbytes < 1000:
                return NotImplemented
            self.num_files += 1
            path = folder / f"{self.num_files}.npy"
            np.save(path, value)
            return np.load, (path, "r")

    file = io.BytesIO()
    Mapping(file, protocol=5).dump(value)
    return pickle.loads(file.getvalue())


def airways_of_every_kind() -> dict[str, carina.Airways]:
    case = edit_case()
    tips = case.airways.tree.tips()
    renamed = carina.edit_airways(case.volume, case.airways, RenameBranch(tips[0].id, "biopsy"))
    start = case.airways.tree.root.points[3]
    return {
        "found": case.airways,
        "renamed": renamed,
        "cut": carina.edit_airways(case.volume, renamed, CutBranch(tips[-1].id)),
        "rerooted": carina.edit_airways(case.volume, case.airways, MoveRoot(tuple(float(v) for v in start))),
    }


KINDS = ("found", "renamed", "cut", "rerooted")


@pytest.fixture(scope="module")
def every_kind() -> dict[str, carina.Airways]:
    return airways_of_every_kind()


def assert_same_airways(made: carina.Airways, expected: carina.Airways) -> None:
    assert_same_tree(made.tree, expected.tree)
    for name in ("lumen_zyx", "root_lps"):
        np.testing.assert_array_equal(getattr(made, name), getattr(expected, name))
    assert not made.lumen_zyx.flags.writeable
    assert (made.lumen_zyx is made.tracker.lumen_zyx) == (expected.lumen_zyx is expected.tracker.lumen_zyx)
    for name in ("threshold", "notes", "wall_levels", "edits", "next_id", "uncertain"):
        assert repr(getattr(made, name)) == repr(getattr(expected, name)), name
    for branch in expected.tree.tips():
        one, other = made.tracker.path_to(branch.tip_lps), expected.tracker.path_to(branch.tip_lps)
        for field in dataclasses.fields(one):
            np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name), err_msg=field.name)
        route, wanted = made.tree.route_to(branch.id), expected.tree.route_to(branch.id)
        np.testing.assert_array_equal(route.points_lps, wanted.points_lps)
    if expected.base is not None:
        assert made.base is not None
        assert made.evidence is made.base.evidence
        assert_same_tree(made.base.tree, expected.base.tree)


@pytest.mark.parametrize("way", [by_pickle, by_buffers, copy.copy, copy.deepcopy])
@pytest.mark.parametrize("kind", KINDS)
def test_copied_or_pickled_airways_equal_the_original(
    kind: str, way: Callable[[Any], Any], every_kind: dict[str, carina.Airways]
) -> None:
    assert_same_airways(way(every_kind[kind]), every_kind[kind])


def test_airways_pickled_with_memory_mapped_files_equal_the_original(
    tmp_path: Path, every_kind: dict[str, carina.Airways]
) -> None:
    assert_same_airways(by_mapped_files(every_kind["cut"], tmp_path), every_kind["cut"])


@pytest.mark.parametrize("kind", KINDS)
def test_edit_of_copied_airways_equals_the_edit_of_the_original(
    kind: str, every_kind: dict[str, carina.Airways]
) -> None:
    volume, airways = edit_case().volume, every_kind[kind]
    copied_volume, copied = by_pickle((volume, airways))
    assert copied.tracker.grid.ct is copied_volume
    edit = CutBranch(airways.tree.tips()[1].id)
    expected = carina.edit_airways(volume, airways, edit)
    assert_same_airways(carina.edit_airways(copied_volume, copied, edit), expected)


def test_edits_paths_and_measurements_in_another_process_are_equal(tmp_path: Path) -> None:
    case = edit_case()
    target = tuple(float(v) for v in case.airways.tree.tips()[0].tip_lps)
    given, made = tmp_path / "given.pickle", tmp_path / "made.pickle"
    given.write_bytes(pickle.dumps((case.volume, case.airways, target)))
    subprocess.run([sys.executable, "-c", IN_ANOTHER_PROCESS, str(given), str(made)], check=True)
    edited, path, measures = pickle.loads(made.read_bytes())
    cut = CutBranch(case.airways.tree.tips()[-1].id)
    assert_same_airways(edited, carina.edit_airways(case.volume, case.airways, cut))
    np.testing.assert_array_equal(path.points_lps, case.airways.tracker.path_to(target).points_lps)
    assert repr(measures) == repr(measure_tree(case.volume, case.airways).to_json())


def test_pickled_airways_of_divided_slices_equal_the_original() -> None:
    made = carina.generate_phantom(spacing_mm=(0.9, 0.9, 3.0), generations=3, box_lps=((-60, -60, -40), (60, 60, 120)))
    airways = carina.find_airways(made.volume)
    assert airways.tracker.grid.is_divided
    assert_same_airways(by_pickle(airways), airways)


def test_pickle_of_airways_stores_the_lumen_compressed() -> None:
    case = edit_case()
    without = len(pickle.dumps(case.volume))
    assert len(pickle.dumps((case.volume, case.airways))) - without < 0.5 * case.airways.lumen_zyx.nbytes


def test_pickling_does_not_build_a_path_tracker_that_was_not_used() -> None:
    tracker: PathTracker = by_pickle(by_pickle(edit_case().airways.tracker))
    assert repr(tracker) == "PathTracker(not built yet)"
    assert tracker.num_nodes == edit_case().airways.tracker.num_nodes


def test_pickled_volume_is_read_only_and_contains_its_cached_results() -> None:
    volume = edit_case().volume
    found = volume.value_range
    copied = by_pickle(volume)
    assert not copied.hu_zyx.flags.writeable and not copied.lps_from_ijk.flags.writeable
    assert copied._range == found
    np.testing.assert_array_equal(copied.hu_zyx, volume.hu_zyx)


@pytest.mark.parametrize("mask", [np.zeros((3, 4, 5)), np.ones((3, 4, 5)), np.eye(4)[None], np.eye(5)[:, None] * 255])
def test_mask_restored_from_its_packed_form_equals_the_original(mask: np.ndarray) -> None:
    made = PackedMask.of(mask.astype(np.uint8)).mask_zyx()
    np.testing.assert_array_equal(made, mask != 0)
    assert made.dtype == np.uint8 and not made.flags.writeable


@pytest.mark.parametrize("way", [by_pickle, copy.copy, copy.deepcopy])
def test_copied_flight_path_equals_the_original(way: Callable[[Any], Any]) -> None:
    route = edit_case().airways.tree.route_to(edit_case().airways.tree.tips()[0].id)
    path = carina.FlightPath(route.points_lps, forks_mm=route.forks_mm)
    copied = way(path)
    assert (copied.forks_mm, copied.lookouts_mm) == (path.forks_mm, path.lookouts_mm)
    np.testing.assert_array_equal(copied.points_lps, path.points_lps)
    np.testing.assert_array_equal(copied.pose_at(10.0).lps_from_camera, path.pose_at(10.0).lps_from_camera)


def test_pickled_error_of_every_kind_equals_the_original() -> None:
    label = MaskLabel(3, "tumour", 1.5)
    full = DiskError("the disk is full", code="disk.full")
    full.errno = 28
    for error in (
        carina.UsageError("wrong", code="usage.range"),
        carina.VolumeImportError("refused", code="import.clipped"),
        full,
        MaskLabelError("several", labels=(label,)),
        NoEvidenceError("no wall", doubtful_mm=4.0, way_lps=np.zeros((2, 3)), doubtful=np.array([True])),
    ):
        for made in (by_pickle(error), copy.copy(error)):
            assert type(made) is type(error)
            assert (str(made), made.code, made.exit_code) == (str(error), error.code, error.exit_code)
            assert vars(made).keys() == vars(error).keys()
    assert by_pickle(full).errno == 28
    assert by_pickle(MaskLabelError("several", labels=(label,))).labels == (label,)


def test_pickling_of_objects_that_belong_to_one_process_is_refused_with_a_remedy() -> None:
    case = edit_case()
    wall = carina.wall_field(case.volume, case.airways)
    assert copy.copy(wall) is wall and copy.deepcopy({"wall": wall})["wall"] is wall
    drive = carina.ScopeDrive(wall, "ultrathin", case.airways.tree.root.points)
    with carina.Case.open(case.volume) as opened:
        for value, remedy in (
            (wall, "make the wall from them with carina.wall_field in the other process"),
            (drive, "create a carina.ScopeDrive in the other process"),
            (carina.Renderer(case.volume), "create a carina.Renderer of it in the other process"),
            (opened, "open the file with carina.Case.open in the other process"),
        ):
            with pytest.raises(TypeError, match=remedy) as refused:
                pickle.dumps(value)
            assert str(refused.value).startswith(f"a {type(value).__name__} cannot be copied or pickled; ")


@pytest.mark.parametrize("way", [copy.copy, copy.deepcopy, carina.ScopeDrive.copy])
def test_copied_or_pickled_scope_moves_like_the_original_and_independently(way: Callable[[Any], Any]) -> None:
    case = edit_case()
    wall = carina.wall_field(case.volume, case.airways)
    drive = carina.ScopeDrive(wall, "ultrathin", case.airways.tree.root.points)
    drive.drive(4.0, 0.0, 0.0, 0.1)
    copied = way(drive)
    before = drive.state.pose.lps_from_camera.copy()
    moved = copied.drive(8.0, 0.3, 0.2, 0.1)
    np.testing.assert_array_equal(drive.state.pose.lps_from_camera, before)
    np.testing.assert_array_equal(drive.drive(8.0, 0.3, 0.2, 0.1).pose.lps_from_camera, moved.pose.lps_from_camera)


@pytest.mark.ray
def test_airways_pickled_by_ray_equal_the_original() -> None:
    from ray import cloudpickle

    case = edit_case()
    buffers: list[pickle.PickleBuffer] = []
    data = cloudpickle.dumps(case.airways, protocol=5, buffer_callback=buffers.append)
    assert_same_airways(pickle.loads(data, buffers=[bytes(one.raw()) for one in buffers]), case.airways)
