"""Tests of invalid arguments of the renderer, which are refused with the value found, and of unusual valid ones."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from carina.errors import CarinaError, RenderError, UsageError
from carina.render import (
    AirwayView,
    CutPlaneView,
    Renderer,
    SliceView,
    TransferFunction,
    TreeView,
    TriPlaneView,
    XrayView,
    render_view,
)
from carina.scopes import Pose
from carina.volume import Volume

NAN, INF = float("nan"), float("inf")


@pytest.fixture(scope="module")
def ball():
    """Return a ball of air in tissue on an anisotropic, mirrored grid."""
    z, y, x = np.mgrid[:20, :22, :24]
    inside = (x - 11.5) ** 2 + (y - 10.5) ** 2 + (z - 9.5) ** 2 < 64
    matrix = np.diag([0.8, 1.1, -1.4, 1.0])
    matrix[:3, 3] = (5.0, -7.0, 40.0)
    return Volume(np.where(inside, -1000, 40).astype(np.int16), matrix)


def pose(at=(0.0, 0.0, 0.0)):
    return Pose.looking(at, (0.0, 0.0, -1.0))


def refusal(make, error=CarinaError):
    with pytest.raises(error) as refused:
        make()
    assert refused.value.exit_code == 2
    return str(refused.value)


@pytest.mark.parametrize(
    ("at", "look", "up", "text"),
    [
        ((NAN, 0, 0), (0, 0, 1), None, "finite.*nan"),
        ((0, INF, 0), (0, 0, 1), None, "finite.*inf"),
        ((0, 0), (0, 0, 1), None, r"three.*\[0\.0, 0\.0\]"),
        ((0, 0, 0), (0, 0, 0), None, r"longer than 0.*direction \[0\.0, 0\.0, 0\.0\]"),
        ((0, 0, 0), (0, NAN, 0), None, "nan"),
        ((0, 0, 0), (1e-12, 0, 0), None, "longer than 0.*1e-12"),
        ((0, 0, 0), (0, 0, 1), (0, 0, 0), r"longer than 0.*up \[0\.0, 0\.0, 0\.0\]"),
        ((0, 0, 0), (0, 0, 1), (0, 0, -2), r"not parallel.*up \[0\.0, 0\.0, -2\.0\]"),
        ((0, 0, 0), (0, 0, 1), (0, NAN, 0), "finite.*nan"),
        ((0, 0, 0), (0, 0, 1), (0, 1), r"three.*\[0\.0, 1\.0\]"),
    ],
)
def test_argument_that_is_not_a_pose_is_refused_with_the_value_found(at, look, up, text):
    assert re.search(text, refusal(lambda: Pose.looking(at, look, up), UsageError))


@pytest.mark.parametrize(
    ("matrix", "text"),
    [
        (np.full((4, 4), NAN), "finite.*nan"),
        (np.eye(3), r"4x4.*\(3, 3\)"),
        (np.diag([2.0, 1, 1, 1]), "unit vectors.*lengths 2, 1, 1"),
        (np.diag([-1.0, 1, 1, 1]), "right-handed.*determinant -1"),
        (np.diag([1.0, 1, 1, 2]), "last row"),
        (np.array([[1, 0.1, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]]), "right angles"),
    ],
)
def test_matrix_that_is_not_a_rigid_pose_is_refused_with_the_value_found(matrix, text):
    assert re.search(text, refusal(lambda: Pose(matrix), UsageError))


VIEWS = {
    "airway": lambda **o: AirwayView(pose(), **o),
    "cut-plane": lambda **o: CutPlaneView(pose(), **o),
    "tri-plane": lambda **o: TriPlaneView((0.0, 0.0, 0.0), **o),
    "slice": lambda **o: SliceView("axial", (0.0, 0.0, 0.0), **o),
    "xray": lambda **o: XrayView("axial", **o),
    "tree": TreeView,
}


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("size", [{"width": 0}, {"height": 0}, {"width": -1}, {"height": 8193}, {"width": 10**9}])
def test_picture_size_out_of_range_is_refused_with_the_value_found(view, size):
    text = refusal(lambda: VIEWS[view](**size), RenderError)
    assert "1 to 8192" in text
    assert str(next(iter(size.values()))) in text


@pytest.mark.parametrize("view", ["airway", "tri-plane", "tree"])
@pytest.mark.parametrize("fov_deg", [0.0, 0.99, 170.01, 180.0, -90.0, NAN, INF])
def test_field_of_view_out_of_range_is_refused_with_the_value_found(view, fov_deg):
    text = refusal(lambda: VIEWS[view](fov_deg=fov_deg), RenderError)
    assert "between 1 and 170" in text
    assert f"{fov_deg:g}" in text


@pytest.mark.parametrize("step_vox", [0.0, -1.0, 0.009, 101.0, NAN])
def test_ray_step_out_of_range_is_refused_with_the_value_found(step_vox):
    text = refusal(lambda: AirwayView(pose(), step_vox=step_vox), RenderError)
    assert "between 0.01 and 100" in text
    assert str(step_vox) in text


@pytest.mark.parametrize("transparency", [0.0, -1.0, 0.5, NAN])
def test_stop_limit_out_of_range_is_refused_with_the_value_found(transparency):
    text = refusal(lambda: AirwayView(pose(), stop_transparency=transparency), RenderError)
    assert "between 1/65536 and 1/4" in text
    assert str(transparency) in text


@pytest.mark.parametrize(
    ("points", "text"),
    [
        ([], r"at least one.*\(0,\)"),
        ([[0, 1, 1, 1]], r"hu, r, g, b, alpha.*\(1, 4\)"),
        ([[0, 1, 1, 1, 1], [NAN, 1, 1, 1, 1]], "finite.*point 1.*nan"),
        ([[0, 1, 1, 1, INF]], "0 to 1.*point 0.*inf"),
        ([[0, 1, 1, 1, 0.5], [1, 1, 1.01, 1, 0.5]], r"0 to 1.*point 1.*1\.01"),
        ([[0, -0.5, 1, 1, 0.5]], r"0 to 1.*point 0.*-0\.5"),
        ([[5, 1, 1, 1, 0], [4, 1, 1, 1, 1]], "increasing order.*4.*after 5"),
    ],
)
def test_value_that_is_not_a_transfer_function_is_refused_with_the_value_found(points, text, tmp_path):
    assert re.search(text, refusal(lambda: TransferFunction(points=np.array(points, dtype=float)), RenderError))
    if not re.search("nan|inf", text):
        document = {"format": "carina-transfer", "version": 1, "points": points}
        assert re.search(text, refusal(lambda: TransferFunction.from_json_text(json.dumps(document)), RenderError))


def test_picture_of_excessive_size_is_refused_before_it_is_rendered(ball):
    for options in ({"width": 8193}, {"fov_deg": 171.0}, {"step_vox": 0.0}):
        refusal(lambda o=options: render_view(ball, view="airway", pose=pose(ball.centre_lps), **o), RenderError)


# Unusual but valid arguments


@pytest.mark.parametrize("method", ["leap", "brute"])
def test_camera_extremely_far_from_the_volume_renders_only_the_background(ball, method):
    renderer = Renderer(ball)
    renderer.prepare()
    for far in (1e4, 1e7, 1e12, 1e30):
        at = ball.centre_lps + np.array([far, 0.3 * far, 0.0])
        away = AirwayView(Pose.looking(at, (1.0, 0.0, 0.0)), width=24, height=20, method=method)
        assert not renderer.render(away).rgb.any()
        towards = AirwayView(Pose.looking(at, ball.centre_lps - at), width=24, height=20, method=method, fov_deg=60.0)
        assert renderer.render(towards).rgb.shape == (20, 24, 3)


def test_picture_from_a_camera_on_a_face_of_the_volume_equals_that_from_just_inside(ball):
    renderer = Renderer(ball)
    renderer.prepare()
    face = ball.to_lps(np.array([-0.5, 10.0, 9.0]))
    look = ball.to_lps(np.array([12.0, 10.0, 9.0])) - face
    pictures = [
        renderer.render(AirwayView(Pose.looking(face + hair * look, look), width=32, height=24)).rgb.astype(int)
        for hair in (0.0, 1e-7)
    ]
    assert pictures[0].any()
    # A shift of 1e-7 of the distance is 1e-6 voxels, so at most a rounding error.
    assert np.abs(pictures[0] - pictures[1]).max() <= 1


def test_rays_that_stop_earlier_take_fewer_samples_and_differ_by_at_most_4_levels(ball):
    renderer = Renderer(ball)
    renderer.prepare()
    at = Pose.looking(ball.centre_lps, (0.3, 0.2, -1.0))
    far, near = (renderer.render(AirwayView(at, width=40, height=30, stop_transparency=t)) for t in (1 / 512, 1 / 64))
    assert near.stats.num_samples < far.stats.num_samples
    # Samples beyond the stop limit contribute at most 255/64 levels.
    assert np.abs(near.rgb.astype(int) - far.rgb.astype(int)).max() <= 4
