"""Tests of camera calibration files: files of OpenCV, and damaged files."""

from __future__ import annotations

import json

import numpy as np
import pytest

from carina.errors import VolumeImportError
from carina.scopes import lens_from_file, lens_from_text

YAML = """%YAML:1.0
---
calibration_time: "Sat Nov 21 09:00:00 2026"
image_width: 640
image_height: 480
flags: 0
# flags: +fix_k4
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 5.3591573396163199e+02, 0., 3.4228315473308373e+02, 0.,
       5.3591573396163199e+02, 2.3557082909788173e+02, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -2.6637260909660682e-01, -3.8588898922304653e-02,
       1.7831947042852964e-03, -2.8122100441115472e-04,
       2.3839153080878486e-01 ]
avg_reprojection_error: 3.9259109564815858e-01
"""
"""YAML file of a calibration, as written by cv2.FileStorage of OpenCV 4."""
XML = """<?xml version="1.0"?>
<opencv_storage>
<image_width>640</image_width>
<image_height>480</image_height>
<camera_matrix type_id="opencv-matrix">
  <rows>3</rows>
  <cols>3</cols>
  <dt>d</dt>
  <data>
    5.3591573396163199e+02 0. 3.4228315473308373e+02 0.
    5.3591573396163199e+02 2.3557082909788173e+02 0. 0. 1.</data></camera_matrix>
<distortion_coefficients type_id="opencv-matrix">
  <rows>5</rows>
  <cols>1</cols>
  <dt>d</dt>
  <data>
    -2.6637260909660682e-01 -3.8588898922304653e-02
    1.7831947042852964e-03 -2.8122100441115472e-04
    2.3839153080878486e-01</data></distortion_coefficients>
</opencv_storage>
"""
"""XML file of the same calibration, as written by cv2.FileStorage."""
JSON = """{
    "image_width": 640,
    "image_height": 480,
    "camera_matrix": {
        "type_id": "opencv-matrix",
        "rows": 3,
        "cols": 3,
        "dt": "d",
        "data": [ 535.91573396163199, 0.0, 342.28315473308373, 0.0, 535.91573396163199, 235.57082909788173,
            0.0, 0.0, 1.0 ]
    },
    "distortion_coefficients": {
        "type_id": "opencv-matrix",
        "rows": 5,
        "cols": 1,
        "dt": "d",
        "data": [ -0.26637260909660682, -0.038588898922304653, 0.0017831947042852964, -0.00028122100441115472,
            0.23839153080878486 ]
    }
}
"""
"""JSON file of the same calibration."""
FISHEYE = {
    "image_size": [1280, 720],
    "fisheye_model": 1,
    "K": [[520.0, 0.0, 640.2], [0.0, 519.0, 355.5], [0.0, 0.0, 1.0]],
    "D": [[0.03], [-0.01], [0.004], [-0.0007]],
}
"""Calibration of OpenCV's fisheye model as JSON values."""


def test_camera_calibration_in_three_file_formats_gives_equal_lenses():
    lens = lens_from_text(YAML)
    assert lens == lens_from_text(XML) == lens_from_text(JSON)
    assert lens.model == "brown"
    k1, k2, p1, p2, k3, *rest = lens.coefficients
    assert (k1, k2, p1, p2, k3) == (
        -2.6637260909660682e-01,
        -3.8588898922304653e-02,
        1.7831947042852964e-03,
        -2.8122100441115472e-04,
        2.3839153080878486e-01,
    )
    assert rest == [0.0, 0.0, 0.0]
    # The offset is half a pixel, because OpenCV counts from the centre of the first pixel.
    assert lens.calibration.centre_px == (342.28315473308373 + 0.5, 235.57082909788173 + 0.5)


def test_camera_calibration_is_scaled_to_the_size_of_the_picture():
    lens = lens_from_text(YAML)
    full, half = lens.optics(640, 480), lens.optics(320, 240)
    at = np.array([[10.0, 20.0], [600.0, 400.0]])
    assert np.allclose(full.directions_of(at), half.directions_of(at / 2), rtol=0, atol=1e-12)
    # The field of view is that of 480 pixels at a focal length of 536 pixels, slightly larger because of barrel
    # distortion.
    assert 48.3 < full.fov_deg < 53.0
    with pytest.raises(ValueError, match=r"640 x 480, such as 512 x 384.*found 512 x 512"):
        lens.optics(512, 512)
    with pytest.raises(ValueError, match="calibration has its own"):
        lens.optics(640, 480, 90.0)


def test_fisheye_calibration_is_recognised_by_its_key():
    lens = lens_from_text(json.dumps(FISHEYE))
    assert lens.model == "fisheye" and lens.coefficients == (0.03, -0.01, 0.004, -0.0007)
    # The formula is that of Kannala and Brandt, at 30 degrees to the right.
    a = np.deg2rad(30.0)
    r = a * (1 + 0.03 * a**2 - 0.01 * a**4 + 0.004 * a**6 - 0.0007 * a**8)
    found = lens.optics(1280, 720).pixels_of([[np.sin(a), 0.0, np.cos(a)]])[0]
    assert found == pytest.approx([640.7 + 520 * r, 356.0], abs=1e-9)
    # Four coefficients without the fisheye key belong to OpenCV's default model.
    plain = {key: value for key, value in FISHEYE.items() if key != "fisheye_model"}
    assert lens_from_text(json.dumps(plain)).model == "brown"
    ros = "image_width: 64\nimage_height: 48\ndistortion_model: equidistant\ncamera_matrix:\n  rows: 3\n  cols: 3\n"
    ros += "  data: [50, 0, 31.5, 0, 50, 23.5, 0, 0, 1]\ndistortion_coefficients:\n  rows: 1\n  cols: 4\n"
    assert lens_from_text(ros + "  data: [0, 0, 0, 0]\n").model == "fisheye"


BROKEN = {
    "empty": ("", "no camera_matrix"),
    "no matrix": (YAML.replace("camera_matrix", "matrix_of_camera"), "no camera_matrix"),
    "no distortion": (YAML.replace("distortion_coefficients", "other"), "no distortion_coefficients"),
    "no size": (YAML.replace("image_width", "w"), "no image_width or image_height"),
    "size of words": (YAML.replace("640", "wide"), "image_width: expected numbers, found 'wide'"),
    "size of 0": (YAML.replace("image_width: 640", "image_width: 0"), "1 to 1048576"),
    "nan": (YAML.replace("-2.6637260909660682e-01", ".Nan"), "finite numbers, found nan"),
    "inf": (YAML.replace("5.3591573396163199e+02, 0.,", ".Inf, 0.,"), "finite numbers, found inf"),
    "nan in json": (JSON.replace("535.91573396163199, 0.0, 342", "NaN, 0.0, 342"), "finite numbers, found nan"),
    "a number less": (YAML.replace(", 1. ]", " ]").replace("0., 0.,", "0.,"), "expected 3 x 3 numbers, found 8"),
    "rows that lie": (YAML.replace("rows: 5", "rows: 6"), "expected 6 x 1 numbers, found 5"),
    "six coefficients": (json.dumps({**FISHEYE, "D": [0.1] * 6, "fisheye_model": 0}), "found 6 numbers"),
    "five for a fisheye": (json.dumps({**FISHEYE, "D": [0.1] * 5}), "expected k1 to k4"),
    "skew": (json.dumps({**FISHEYE, "K": [[520, 3, 640], [0, 519, 355], [0, 0, 1]]}), "fx 0 cx"),
    "no focal length": (json.dumps({**FISHEYE, "K": [[0, 0, 640], [0, 519, 355], [0, 0, 1]]}), "above 0 pixels"),
    "principal point outside": (
        json.dumps({**FISHEYE, "K": [[520, 0, 2000], [0, 519, 355], [0, 0, 1]]}),
        "lies outside the image of 1280 x 720",
    ),
    "folded": (YAML.replace("-2.6637260909660682e-01", "-2.9e+00"), "folds back"),
    "unknown model": (json.dumps({**FISHEYE, "distortion_model": "mei"}), "found 'mei'"),
    "entities": ('<!DOCTYPE a [<!ENTITY b "c">]><opencv_storage/>', "document type"),
    "broken xml": ("<opencv_storage><a></opencv_storage>", "not valid XML"),
    "broken json": ('{"camera_matrix": ', "not valid JSON"),
    "prose": ("a lens of good quality", "on line 1"),
    "list nested too deeply": ("camera_matrix: [1, 2\n", "has no closing bracket"),
    "deep json": ('{"K": ' + "[" * 100_000 + "]" * 100_000 + "}", "nested too deeply"),
    "booleans": (json.dumps({**FISHEYE, "D": [True, 0, 0, 0]}), "expected numbers, found True"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_invalid_camera_calibration_is_refused_with_the_defect(name, tmp_path):
    text, message = BROKEN[name]
    path = tmp_path / "lens.yml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(VolumeImportError) as refusal:
        lens_from_file(path)
    assert message in str(refusal.value) and str(path) in str(refusal.value)
    assert refusal.value.exit_code == 3 and refusal.value.code == "render.lens"


def test_file_without_a_camera_calibration_is_refused(tmp_path):
    for name, data in (("binary.yml", b"\xff\xfe\x00\x81"), ("huge.yml", b"#" * 1_000_001)):
        (tmp_path / name).write_bytes(data)
        with pytest.raises(VolumeImportError):
            lens_from_file(tmp_path / name)
    with pytest.raises(VolumeImportError, match="cannot be read"):
        lens_from_file(tmp_path / "missing.yml")
