"""Test of the projection of points through each lens: a file of random points, for Python and TypeScript.

``web/src/state/projection.test.ts`` reads the same file. Only ``make golden`` rewrites it.
"""

from __future__ import annotations

import json
import math
import os
from pathlib import Path

import msgspec
import numpy as np
import pytest

from carina.render import Picture
from carina.scopes import Lens, Pose, lens_from_text, scope_preset
from carina.server.frames.pump import _lens_message

FILE = Path(__file__).resolve().parents[1] / "golden" / "projections.json"
CALIBRATION = """{"image_size": [320, 240], "K": [[210.5, 0, 163.25], [0, 208.75, 117.5], [0, 0, 1]],
    "D": [-0.21, 0.06, 0.0015, -0.0008, 0.004, 0.02, -0.01, 0.001]}"""
LENSES: dict[str, tuple[Lens, float | None]] = {
    "pinhole 100": (Lens.pinhole(), 100.0),
    "equidistant 170": (Lens.equidistant(), 170.0),
    "generic 120": (scope_preset("generic").lens, 120.0),
    "brown 90": (Lens.brown(-0.18, 0.03, p1=1e-3, p2=-2e-3), 90.0),
    "calibration": (lens_from_text(CALIBRATION), None),
}


def make() -> list[dict[str, object]]:
    rng = np.random.default_rng(20261121)
    made = []
    for name, (lens, fov_deg) in LENSES.items():
        look, up = rng.normal(size=3), rng.normal(size=3)
        pose = Pose.looking(rng.uniform(-100, 100, 3), look, up)
        optics = lens.optics(320, 240, fov_deg)
        picture = Picture(
            np.zeros((240, 320, 3), np.uint8),
            "airway",
            stats=None,
            lps_from_camera=pose.lps_from_camera,
            fov_deg=optics.fov_deg,
            optics=None if name.startswith("pinhole") else optics,
        )
        # The points are in all directions at 2 to 60 mm, half of them in front of the camera.
        directions = rng.normal(size=(60, 3))
        directions[::2] += 2.0 * pose.forward_lps
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        # Points within one degree of the edge of a lens, or of the angle at which TypeScript cuts lines, are excluded.
        angle = np.degrees(np.arccos(directions @ pose.forward_lps))
        ends = (optics.limit_deg, 120.0, 90.0)
        directions = directions[np.all([np.abs(angle - end) > 1.0 for end in ends], axis=0)]
        distances = rng.uniform(2.0, 60.0, len(directions))
        # TypeScript draws no point nearer than 0.5 mm to the plane of a pinhole.
        clear = np.abs(directions @ pose.forward_lps * distances) > 1.0
        directions, distances = directions[clear], distances[clear]
        points = pose.position_lps + directions * distances[:, None]
        seen = [picture.pixel_of(p) for p in points]
        # TypeScript cuts lines at larger angles.
        ahead = directions @ pose.forward_lps > math.cos(math.radians(120.0))
        made.append(
            {
                "name": name,
                "width": 320,
                "height": 240,
                "fov_deg": optics.fov_deg,
                "lens": msgspec.to_builtins(_lens_message(picture.optics)) if picture.optics else None,
                "lps_from_camera": [float(v) for v in pose.lps_from_camera.ravel()],
                "points_lps": [[float(v) for v in p] for p in points],
                "pixels": [s if near else None for s, near in zip(seen, ahead, strict=True)],
            }
        )
    return made


def test_projected_points_of_the_golden_file_equal_those_computed_by_python():
    made = json.loads(json.dumps(make()))
    if os.environ.get("CARINA_GOLDEN") == "rewrite":
        FILE.write_text(json.dumps(made, indent=1) + "\n", encoding="utf-8")
    golden = json.loads(FILE.read_text(encoding="utf-8"))
    assert [case["name"] for case in golden] == list(LENSES)
    for found, expected in zip(made, golden, strict=True):
        assert (found["lens"] is None) == (expected["lens"] is None)
        assert found["points_lps"] == [pytest.approx(p, abs=1e-9) for p in expected["points_lps"]]
        assert sum(p is not None for p in expected["pixels"]) >= 10
        assert any(p is None for p in expected["pixels"])
        for a, b in zip(found["pixels"], expected["pixels"], strict=True):
            assert (a is None) == (b is None)
            assert a is None or math.dist(a, b) < 1e-6
