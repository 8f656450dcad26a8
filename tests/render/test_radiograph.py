"""Tests of radiographs: laterality at any C-arm angle, magnification, grey values, and projection of marks."""

from __future__ import annotations

import numpy as np
import pytest
from test_planes import GRIDS, MIDDLE, bright_centre, volume_with_blob

from carina.errors import RenderError
from carina.render import DrrView, Renderer, letter_edges, mark_tip
from carina.render.picture_text import letters_of
from carina.volume import Volume

ANGLES = [(0.0, 0.0), (90.0, 0.0), (-30.0, 20.0), (45.0, -35.0), (180.0, 0.0), (10.0, 90.0)]


@pytest.mark.parametrize("axes", GRIDS)
@pytest.mark.parametrize("parallel", [False, True])
@pytest.mark.parametrize(("primary", "secondary"), ANGLES)
def test_marked_point_in_a_radiograph_is_at_the_projection_of_the_point(axes, parallel, primary, secondary):
    point = np.add(MIDDLE, (7.0, -4.0, 5.0))
    renderer = Renderer(volume_with_blob(axes, point))
    picture = renderer.render(DrrView(primary, secondary, 90, 80, parallel=parallel, window_mm=(8.0, 4.0)))
    found, expected = bright_centre(picture.rgb), picture.pixel_of(point)
    # The blob consists of whole voxels of 2 mm; a pixel is about 0.8 mm.
    assert np.hypot(found[0] - expected[0], found[1] - expected[1]) < 1.6


@pytest.mark.parametrize("axes", GRIDS)
def test_fluoroscopy_has_patient_right_on_the_left_and_rotates_as_dicom_defines(axes):
    """Check PS3.3 C.8.7.5.1.2: LAO moves the detector over the patient's left, cranial moves it towards the head."""
    left, front, head = (np.add(MIDDLE, d) for d in ((7.0, 0, 0), (0, -7.0, 0), (0, 0, 7.0)))

    def place_of(point, primary, secondary):
        view = DrrView(primary, secondary, 90, 90, window_mm=(8.0, 4.0))
        column, row = bright_centre(Renderer(volume_with_blob(axes, point)).render(view).rgb)
        return column - 45.0, row - 45.0

    assert place_of(left, 0, 0)[0] > 4
    assert place_of(head, 0, 0)[1] < -4
    assert abs(place_of(front, 0, 0)[0]) < 2
    # Seen from the patient's left, anterior is on the left.
    assert place_of(front, 60, 0)[0] < -4
    assert place_of(front, -60, 0)[0] > 4
    # Seen from above, the anterior point moves down.
    assert place_of(front, 0, 50)[1] > 3
    assert place_of(front, 0, -50)[1] < -3


def test_orientation_letters_of_a_radiograph_are_those_of_fluoroscopy():
    volume = volume_with_blob(np.eye(3), MIDDLE)

    def edges(primary, secondary):
        camera = Renderer(volume).render(DrrView(primary, secondary, 60, 60)).lps_from_camera
        return letters_of(-camera[:3, 0]), letters_of(camera[:3, 0]), letters_of(-camera[:3, 1])

    assert edges(0, 0) == ("R", "L", "S")
    assert edges(90, 0) == ("A", "P", "S")
    assert edges(-90, 0) == ("P", "A", "S")
    assert edges(180, 0) == ("L", "R", "S")
    assert edges(30, 0) == ("RA", "LP", "S")
    assert edges(0, 40)[2] == "SP"
    picture = Renderer(volume).render(DrrView(0, 0, 60, 60))
    lettered = letter_edges(picture).rgb
    assert (lettered[20:40, 1:12] > 200).any()
    assert (lettered != picture.rgb).sum() < 4 * 3 * 16 * 14


def test_objects_near_the_x_ray_source_are_magnified_by_the_ratio_of_distances():
    volume = volume_with_blob(np.eye(3), MIDDLE)
    picture = Renderer(volume).render(DrrView(0, 0, 100, 100, sid_mm=1000.0, sod_mm=500.0, mm_per_px=0.5))
    centre = np.array(volume.centre_lps)

    def reach(depth_mm):
        # The source is posterior to the patient, so a more posterior point is nearer to the source.
        a, b = (picture.pixel_of(np.add(centre, (x, depth_mm, 0.0))) for x in (0.0, 10.0))
        return b[0] - a[0]

    # 10 mm at the centre are 20 pixels of 0.5 mm; 100 mm nearer to the source they are 500 / 400 times as large.
    assert reach(0.0) == pytest.approx(20.0)
    assert reach(100.0) == pytest.approx(25.0)
    assert reach(-100.0) == pytest.approx(20.0 * 500 / 600)
    assert picture.pixel_of(np.add(centre, (0, 600.0, 0))) is None


def test_bone_is_white_in_a_radiograph_and_dark_in_fluoroscopy(airway):
    spine = (0.0, 24.0, 10.0)
    hu = airway.volume.hu_zyx
    boneless = Volume(np.where(hu > 300, -450, hu).astype(np.int16), airway.volume.lps_from_ijk)
    for tone, sign in (("radiograph", 1), ("fluoroscopy", -1)):
        view = DrrView(0, 0, 96, 96, tone=tone, window_mm=(80.0, 40.0))
        with_bone, without = (Renderer(v).render(view) for v in (airway.volume, boneless))
        column, row = (int(v) for v in with_bone.pixel_of(spine))
        assert sign * (int(with_bone.rgb[row, column, 0]) - int(without.rgb[row, column, 0])) > 25


def test_tip_marker_is_drawn_in_a_radiograph(airway):
    picture = Renderer(airway.volume).render(DrrView(30, 10, 96, 96))
    marked = mark_tip(picture, airway.pose.position_lps)
    assert (marked.rgb != picture.rgb).any()


def test_radiograph_of_air_is_black_and_one_of_values_that_are_not_hu_has_contrast():
    matrix = np.diag([2.0, 2.0, 2.0, 1.0])
    air = Volume(np.full((8, 9, 10), -1000, dtype=np.int16), matrix)
    assert Renderer(air).render(DrrView(0, 0, 20, 20)).rgb.max() == 0
    rng = np.random.default_rng(3)
    values = rng.integers(0, 40, (20, 22, 24)).astype(np.int16)
    values[5:15, 6:16, 7:17] += 150
    raw = Volume(values, matrix, not_hu_reason="8 bit")
    rgb = Renderer(raw).render(DrrView(20, 10, 40, 40)).rgb
    assert rgb.max() > 200
    assert rgb[20, 20, 0] > rgb[3, 3, 0] + 100


@pytest.mark.parametrize(
    "settings",
    [
        {"primary_deg": 361.0},
        {"primary_deg": float("nan")},
        {"secondary_deg": 91.0},
        {"sod_mm": 50.0},
        {"sod_mm": 900.0, "sid_mm": 800.0},
        {"sid_mm": float("inf")},
        {"mm_per_px": 0.0},
        {"window_mm": (0.0, 5.0)},
        {"tone": "sepia"},
        {"width": 0},
        {"height": 8193},
    ],
)
def test_radiograph_with_settings_out_of_range_is_refused(settings):
    with pytest.raises(RenderError):
        DrrView(**settings)
