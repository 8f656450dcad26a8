"""Tests of lenses and image fields in Python; crates/grid tests the lens models."""

from __future__ import annotations

import math

import numpy as np
import pytest

from carina.errors import RenderError, UsageError
from carina.scopes import PINHOLE, DepthOfField, ImageField, Lens, fit_generic_optics

LENSES = {
    "pinhole": PINHOLE,
    "equidistant": Lens.equidistant(),
    "brown": Lens.brown(-0.12, 0.02),
    "tangential": Lens.brown(-0.1, 0.02, p1=2e-3, p2=-1e-3),
    "fisheye": Lens.fisheye(0.16),
}


@pytest.mark.parametrize("name", LENSES)
def test_lens_direction_of_a_pixel_converts_back_to_the_pixel(name):
    optics = LENSES[name].optics(320, 240, 110.0)
    rng = np.random.default_rng(5)
    # The points are inside the image circle, where every lens has a direction.
    angle, distance = rng.uniform(0, 2 * np.pi, 500), 119.0 * np.sqrt(rng.uniform(0, 1, 500))
    pixels = np.column_stack([160 + distance * np.cos(angle), 120 + distance * np.sin(angle)])
    directions = optics.directions_of(pixels)
    assert np.allclose(np.linalg.norm(directions, axis=1), 1.0, rtol=0, atol=1e-12)
    # The tolerance of 1e-8 px is double precision at several hundred pixels, and the last step of Newton's method.
    assert np.abs(optics.pixels_of(directions * rng.uniform(0.1, 50, (500, 1))) - pixels).max() < 1e-8


def test_equidistant_lens_has_equal_angles_at_equal_distances():
    optics = Lens.equidistant().optics(340, 340, 170.0)
    angles = np.deg2rad([0.0, 20.0, 60.0, 85.0])
    pixels = optics.pixels_of(np.column_stack([np.sin(angles), np.zeros(4), np.cos(angles)]))
    assert np.allclose(pixels[:, 0], 170 + np.array([0, 40, 120, 170]))


def test_opencv_formulas_match_a_point_computed_by_hand():
    # For x = 0.3 and y = -0.4, r^2 is 0.25 and the radial factor is 1 - 0.1 * 0.25 + 0.04 * 0.0625 = 0.9775.
    lens = Lens.brown(-0.1, 0.04, p1=0.01, p2=-0.02)
    optics = lens.optics(200, 200, 90.0)
    x = 0.3 * 0.9775 + 2 * 0.01 * 0.3 * -0.4 + -0.02 * (0.25 + 2 * 0.09)
    y = -0.4 * 0.9775 + 0.01 * (0.25 + 2 * 0.16) + 2 * -0.02 * 0.3 * -0.4
    f = optics.focal_px[0]
    assert optics.pixels_of([[0.6, -0.8, 2.0]])[0] == pytest.approx([100 + f * x, 100 + f * y], abs=1e-10)


def test_directions_outside_the_field_of_view_of_a_lens_have_no_pixel():
    assert np.isnan(PINHOLE.optics(64, 64, 90.0).pixels_of([[0.0, 0.0, -1.0]])).all()
    assert np.isnan(PINHOLE.optics(64, 64, 90.0).pixels_of([[0.0, math.nan, 1.0]])).all()
    # A direction 120 degrees from the axis is in the picture of a fisheye lens if the picture is large enough.
    assert not np.isnan(Lens.equidistant().optics(64, 64, 90.0).pixels_of([[1.0, 0.0, -0.5]])).any()


@pytest.mark.parametrize("fov_deg", [0.0, 0.99, 170.1, 180.0, -90.0, math.nan, math.inf])
@pytest.mark.parametrize("name", LENSES)
def test_field_of_view_out_of_range_is_refused_with_the_value(name, fov_deg):
    with pytest.raises(UsageError, match=r"1 to 170 degrees.*found"):
        LENSES[name].optics(64, 64, fov_deg)


def test_pinhole_and_fitted_fisheye_lens_support_170_degrees():
    for lens in (PINHOLE, Lens.equidistant(), Lens.fisheye(fit_generic_optics().k1)):
        assert lens.optics(64, 64, 170.0).fov_deg == 170.0


def test_lens_whose_image_radius_decreases_is_refused_with_the_largest_valid_angle():
    # With k1 = -0.3 alone, a common start of fits, the radius in the image decreases beyond 46.5 degrees from the axis.
    with pytest.raises(RenderError, match=r"less than 93.0 degrees.*found 120.00"):
        Lens.brown(-0.3).optics(64, 64, 120.0)
    assert Lens.brown(-0.3).optics(64, 64, 90.0).limit_deg == pytest.approx(46.51, abs=0.01)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Lens("brown", (0.1,)),
        lambda: Lens("magic", ()),
        lambda: ImageField("square"),
        lambda: ImageField("round", edge_px=-1.0),
        lambda: ImageField("round", vignette=1.1),
        lambda: ImageField("round", vignette=math.nan),
        lambda: DepthOfField(0.0, 5.0),
        lambda: DepthOfField(5.0, 5.0),
        lambda: DepthOfField(3.0, math.inf),
    ],
)
def test_lens_with_settings_out_of_range_is_refused(make):
    with pytest.raises(RenderError) as refusal:
        make()
    assert refusal.value.code == "render.camera"


@pytest.mark.parametrize("make", [lambda: Lens.brown(math.nan), lambda: Lens.fisheye(math.inf)])
def test_lens_with_non_finite_coefficients_is_refused(make):
    with pytest.raises(UsageError) as refusal:
        make()
    assert refusal.value.code == "usage.range"


def test_lens_fitted_to_published_figures_deviates_only_where_the_figures_contradict_each_other():
    fit = fit_generic_optics()
    relative = {residual.what: residual.relative for residual in fit.residuals}
    # The published figures contradict each other: one pupil cannot give both 9.55 times at 10 mm and 40 times at 3 mm,
    # or two distortions.
    assert relative["magnification at 10 mm, relative to 100 mm"] == pytest.approx(0.092, abs=1e-3)
    assert relative["magnification at 3 mm, relative to 100 mm"] == pytest.approx(-0.022, abs=1e-3)
    assert relative["magnification at 15 mm, centre relative to edge"] == pytest.approx(0.014, abs=1e-3)
    assert relative["edge magnification at 3 mm, as a fraction of the distortion-free value"] == pytest.approx(
        0.014, abs=1e-3
    )
    # The fit minimises the squares: no other pupil has a smaller sum.
    logs = [math.log(1 + r) for what, r in relative.items() if what.startswith("magnification")]
    for face_mm in (fit.face_mm - 0.05, fit.face_mm + 0.05):
        other = [math.log((100 + face_mm) / (d + face_mm) / m) for d, m in ((10, 9.55), (3, 40))]
        assert sum(v * v for v in other) > sum(v * v for v in logs)


def test_magnifications_of_the_fitted_lens_equal_those_stated_by_the_fit():
    fit = fit_generic_optics()
    optics = Lens.fisheye(fit.k1).optics(1000, 1000, 120.0)

    def size_px(distance_mm: float, at_mm: float) -> float:
        """Return the size of 0.02 mm on a chart before the tip, tangential at ``at_mm`` from the middle, pixels."""
        z = distance_mm + fit.face_mm
        (x0, y0), (x1, y1) = optics.pixels_of([[at_mm, -0.01, z], [at_mm, 0.01, z]])
        return math.hypot(x1 - x0, y1 - y0)

    by_what = {r.what: r for r in fit.residuals}
    for d in (10.0, 3.0):
        found = size_px(d, 0.0) / size_px(100.0, 0.0)
        assert found == pytest.approx(by_what[f"magnification at {d:g} mm, relative to 100 mm"].fitted, rel=1e-4)
    edge_mm = (15.0 + fit.face_mm) * math.tan(math.radians(60.0))
    ratio = size_px(15.0, 0.0) / size_px(15.0, edge_mm)
    assert ratio == pytest.approx(by_what["magnification at 15 mm, centre relative to edge"].fitted, rel=1e-4)
