"""Tests of paths with the costs ``walls`` and ``paper`` in volumes without airways: a vessel, 8-bit data, a head."""

from __future__ import annotations

import numpy as np
import pytest

import carina
from carina.errors import NoResultError, UsageError
from carina.track.targets.paper_tracker import NO_LUMEN, search_box, track_on_graph
from vessel_phantom import bent_vessel

HEAD_AND_LIDC2 = "ct/head_and_lidc2_8bit"


@pytest.fixture(scope="module")
def vessel():
    return bent_vessel()


def voxels_of(volume, points):
    return tuple(np.rint(volume.to_ijk(points)).astype(int).T[::-1])


@pytest.mark.parametrize("graph", ["voxel", "isoregion"])
def test_path_with_the_walls_cost_follows_a_bent_vessel(vessel, graph):
    volume, inside, root, corner, end = vessel
    result = carina.track_paths(volume, root=root, targets=[end, corner], cost="walls", graph=graph)
    assert result.airways is None
    assert [target.problem for target in result.targets] == [None, None]
    to_end = result.targets[0].path
    assert inside[voxels_of(volume, to_end.voxel_path_lps)].all()
    # The path must follow the bend (15.4 and 18.9 mm) instead of its chord; the tolerance covers voxel steps.
    assert 0.85 * (15.4 + 18.9) < to_end.length_mm < 1.2 * (15.4 + 18.9)
    # Paths begin and end in the voxels of the given points, so no target was moved.
    half_mm = 0.5 * float(np.linalg.norm(volume.spacing_mm))
    assert np.linalg.norm(to_end.points_lps[0] - root) <= half_mm
    assert np.linalg.norm(to_end.points_lps[-1] - end) <= half_mm
    for row in result.search.targets:
        assert (row.num_outside, row.outside_mm) == (None, None)
        assert 1100 < row.value_range[0] <= row.value_range[1] < 1300
    # The tree of both paths has the note that its lumen is unknown.
    assert result.tree.notes == (NO_LUMEN,)
    assert set(to_end.branch_ids) <= {branch.id for branch in result.tree.branches}
    assert not np.concatenate([branch.radius for branch in result.tree.branches]).any()


def test_path_with_the_paper_cost_follows_vessel_edges_and_reports_its_values(vessel):
    volume, _, root, _, end = vessel
    result = carina.track_paths(volume, root=root, targets=[end], cost="paper")
    assert result.targets[0].path is not None
    assert result.search.targets[0].value_range[0] < 900
    assert result.airways is None


def test_paths_without_a_start_or_with_points_outside_the_volume_are_refused(vessel):
    volume, _, root, _, end = vessel
    outside = np.asarray(end) + np.array([500.0, 0.0, 0.0])
    with pytest.raises(UsageError, match=r"the target .* lies outside the scan"):
        carina.track_paths(volume, root=root, targets=[outside], cost="walls")
    with pytest.raises(UsageError, match=r"the root .* lies outside the scan"):
        carina.track_paths(volume, root=outside, targets=[end], cost="walls")
    with pytest.raises(NoResultError, match="need no airways, but a start point") as caught:
        carina.track_paths(volume, targets=[end], cost="walls")
    assert caught.value.exit_code == 4
    with pytest.raises(NoResultError, match="not in an airway"):
        carina.track_paths(volume, root=root, targets=[end])
    for wrong in ({"cost": "lumen", "graph": "isoregion"}, {"cost": "walls", "graph": "isoregion", "labels": "lumen"}):
        with pytest.raises(UsageError, match="expected an airway lumen"):
            track_on_graph(volume, None, [end], root_lps=root, **wrong)
    with pytest.raises(UsageError, match="give the start"):
        track_on_graph(volume, None, [end], cost="walls", graph="voxel")


def test_target_outside_the_search_box_has_no_path_and_a_reason(vessel):
    volume, _, root, corner, end = vessel
    box = ((0, 0, 0), (20, 44, 26))
    result = track_on_graph(volume, None, [corner, end], cost="walls", graph="voxel", root_lps=root, box_ijk=box)
    assert [target.path is None for target in result.targets] == [False, True]
    assert "outside the box" in result.targets[1].problem
    none = track_on_graph(volume, None, [end], cost="walls", graph="voxel", root_lps=root, box_ijk=box)
    assert none.tree is None


@pytest.mark.data
def test_path_in_8_bit_data_follows_the_aorta_from_arch_to_abdomen(data_dir):
    volume = carina.open_volume(data_dir / HEAD_AND_LIDC2 / "LIDC2_256x256x133_uint8.mha")
    # Points read from four slices by eye, in the middle of the descending aorta.
    root, *targets = volume.to_lps(np.array([[133.0, 93, 46], [133, 93, 66], [135, 110, 86]]))
    result = carina.track_paths(volume, root=root, targets=targets, cost="walls")
    assert result.airways is None
    assert "8 bits" in volume.not_hu_reason
    # Contrast medium is 115 to 140 of 255 in this CT, muscle below 60, lung 0: the path never leaves the vessel.
    assert [row.value_range[0] > 110 and row.value_range[1] < 150 for row in result.search.targets] == [True, True]
    # The path of the search zigzags across the aorta; the relaxed one is nearly as short as a line through the points.
    assert [round(row.search_length_mm) for row in result.search.targets] == pytest.approx([70, 145], abs=6)
    assert [round(target.path.length_mm) for target in result.targets] == pytest.approx([50, 106], abs=2)


@pytest.mark.data
def test_path_that_leaves_the_air_of_the_head_reports_values_of_tissue(data_dir):
    volume = carina.open_volume(data_dir / HEAD_AND_LIDC2 / "headsq_64x64x93_int16.mha")
    # Points read from the slices by eye: nasopharynx, maxillary air in the same slice, and trachea 87 mm below.
    root, near, trachea = volume.to_lps(np.array([[27.0, 35, 32], [22, 42, 32], [30, 30, 90]]))
    result = carina.track_paths(volume, root=root, targets=[near, trachea], cost="walls")
    assert [target.problem for target in result.targets] == [None, None]
    # There is no lumen for comparison. Voxels of 3.2 mm blur the walls of the throat, and the path runs through the
    # tongue, as its values show (soft tissue is 1000 to 1100 here, air 100 to 150).
    assert result.airways is None
    close, far = result.search.targets
    assert close.value_range[1] < 900
    assert far.value_range[1] > 900


@pytest.mark.data
def test_paths_with_the_walls_cost_to_seven_lobar_bronchi_are_inside_the_lumen_for_99_percent(patient_dicom):
    volume = carina.open_volume(patient_dicom)
    airways = carina.find_airways(volume)
    third = [branch for branch in airways.tree.branches if branch.generation == 3]
    ends = [branch.points[-1] for branch in third[:: max(len(third) // 7, 1)][:7]]
    box = search_box(volume, [airways.root_lps, *ends], max_bytes=1 << 28)
    search = track_on_graph(volume, airways, ends, cost="walls", graph="voxel", box_ijk=box).search
    # Slices of 3 mm; for paths to segments the figure is lower: decision 0139.
    outside, nodes = (sum(getattr(row, name) for row in search.targets) for name in ("num_outside", "num_path_nodes"))
    assert nodes > 900
    assert outside <= 0.01 * nodes
