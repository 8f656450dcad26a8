"""Tests of the limits of the geometry checks: a value just inside opens, one just outside is refused or corrected."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from carina.errors import VolumeImportError
from carina.volume.dicom_geometry import grid_from_slices
from carina.volume.dicom_headers import SETTINGS
from carina.volume.grid_headers import _check as check_grid_header
from carina.volume.header_fields import GridHeader
from carina.volume.quality import trusted_generation

ORIGIN_LPS = np.array([-31.5, 12.25, 140.0])
INSIDE, OUTSIDE = 1 - 1e-6, 1 + 1e-6


def stack(
    positions: np.ndarray, *, spacing=(0.7, 0.7), side=512, row=(1.0, 0.0, 0.0), column=(0.0, 1.0, 0.0)
) -> list[SimpleNamespace]:
    """Return slices at these positions, as objects with the header values that the geometry check reads."""
    return [
        SimpleNamespace(
            path=Path(f"IM{n:03d}"),
            file_name=f"IM{n:03d}",
            frame=None,
            rows=side,
            columns=side,
            position_lps=tuple(position),
            row_lps=row,
            column_lps=column,
            spacing_mm=spacing,
            settings=("",) * len(SETTINGS),
        )
        for n, position in enumerate(positions)
    ]


def heights(*gaps: float) -> np.ndarray:
    """Return positions (n, 3) in LPS mm of a straight stack along z with these gaps in mm."""
    z = np.concatenate([[0.0], np.cumsum(gaps)])
    return np.stack([np.zeros_like(z), np.zeros_like(z), z], axis=1) + ORIGIN_LPS


def answer(slices: list[SimpleNamespace]) -> str:
    """Return "opens", the end of the code of a correction, or the end of the code of a refusal."""
    try:
        found = grid_from_slices(slices, what="reading a series")
    except VolumeImportError as error:
        return error.code.removeprefix("import.").removeprefix("geometry.")
    return found.notes[0].code.removeprefix("import.") if found.notes else "opens"


def one_gap(expected: float, share: float) -> list[SimpleNamespace]:
    """Return slices with twenty gaps of ``expected`` mm, of which one is small.

    The small gap is ``share`` times the limit below which two slices are at one position.
    """
    gaps = [expected] * 20
    gaps[10] = max(0.01, 0.02 * expected) * share
    return stack(heights(*gaps))


def longer_gap(expected: float, share: float, tolerance: float, sign: int = 1) -> list[SimpleNamespace]:
    """Return slices with one gap that is off by ``share`` times twice the tolerance.

    The next gap compensates for it.
    """
    gaps = np.full(400, expected)
    gaps[200] += sign * 2 * tolerance * share
    gaps[201] -= sign * 2 * tolerance * share
    # Half of the difference is on each side of the line, so no slice is off the grid by more than the tolerance.
    gaps[199] -= sign * tolerance * share
    gaps[202] += sign * tolerance * share
    return stack(heights(*gaps))


def one_off(expected: float, off_mm: float) -> list[SimpleNamespace]:
    """Return a stack with one slice shifted by ``off_mm`` along the normal."""
    positions = heights(*[expected] * 20)
    positions[10, 2] += off_mm
    return stack(positions)


def wide_gap(gap_mm: float, expected: float) -> list[SimpleNamespace]:
    """Return a stack of slices with one distance of ``gap_mm``; both neighbouring distances compensate for it."""
    gaps = np.full(40, expected)
    gaps[20] = gap_mm
    gaps[21] -= (gap_mm - 2 * expected) / 2
    gaps[19] -= (gap_mm - 2 * expected) / 2
    return stack(heights(*gaps))


def two_distances(usual: float, other: float) -> list[SimpleNamespace]:
    """Return a stack of even slices, then four other distances, which is less than the share that is interpolated."""
    return stack(heights(*[usual] * 60, *[usual * 1.3] * 3, other))


def short_distance(gap_mm: float) -> list[SimpleNamespace]:
    """Return a stack with a usual distance of 1 mm, some of 1.3 mm and one short one."""
    return stack(heights(*[1.0] * 30, *[1.3] * 3, gap_mm, *[1.0] * 5))


def sideways(shift_mm: float, spacing: tuple[float, float], axis: int = 0) -> list[SimpleNamespace]:
    """Return a stack with one slice shifted by ``shift_mm`` perpendicular to the normal."""
    positions = heights(*[1.0] * 20)
    positions[10, axis] += shift_mm
    return stack(positions, spacing=spacing)


def tilted(degrees: float, num_slices: int, gap: float = 1.0, axis: int = 0) -> list[SimpleNamespace]:
    """Return a stack whose slices are shifted sideways evenly, at an angle of ``degrees``."""
    positions = heights(*[gap] * (num_slices - 1))
    positions[:, axis] += (positions[:, 2] - ORIGIN_LPS[2]) * math.tan(math.radians(degrees))
    return stack(positions)


def lean(lean_mm: float, height_mm: float = 4.0) -> list[SimpleNamespace]:
    """Return five slices shifted sideways evenly by ``lean_mm`` in total, at more than 0.2 degrees."""
    positions = heights(*[height_mm / 4] * 4)
    positions[:, 0] += np.linspace(0, lean_mm, 5)
    return stack(positions)


def turned(shift_mm: float, which: str) -> list[SimpleNamespace]:
    """Return a stack whose last slice has a rotated direction, so that its far corner moves by ``shift_mm``."""
    slices = stack(heights(*[1.0] * 5))
    # the far corner moves along a chord around the first corner
    angle = 2 * math.asin(shift_mm / math.hypot(512 * 0.7, 512 * 0.7) / 2)
    c, s = math.cos(angle), math.sin(angle)
    if which == "row":
        slices[-1].row_lps = (c, 0.0, s)
    else:
        slices[-1].column_lps = (0.0, c, s)
    return slices


def stretched(shift_mm: float, axis: int) -> list[SimpleNamespace]:
    """Return a stack whose last slice has another pixel size, so that its far edge moves by ``shift_mm``."""
    slices = stack(heights(*[1.0] * 5))
    spacing = [0.7, 0.7]
    spacing[axis] += shift_mm / 512
    slices[-1].spacing_mm = tuple(spacing)
    return slices


def resized(rows: int, columns: int) -> list[SimpleNamespace]:
    """Return a stack with a last slice of another size."""
    slices = stack(heights(*[1.0] * 5))
    slices[-1].rows, slices[-1].columns = rows, columns
    return slices


BOUNDS = {
    # Two slices at one position: limit of 0.01 mm, or 2 % of the gap.
    "doubled, 2 % of 1.25 mm": (lambda share: one_gap(1.25, share), "duplicate", "irregular"),
    "doubled, 0.01 mm at 0.4 mm": (lambda share: one_gap(0.4, share), "duplicate", "irregular"),
    # A slice off the grid: limit of a tenth of the gap, at least 0.06 and at most 0.3 mm.
    "off by a tenth of 1 mm": (lambda share: one_off(1.0, 0.1 * share), "opens", "slices-resampled"),
    "off by 0.06 mm at 0.5 mm": (lambda share: one_off(0.5, 0.06 * share), "opens", "slices-resampled"),
    "off by 0.3 mm at 5 mm": (lambda share: one_off(5.0, 0.3 * share), "opens", "slices-resampled"),
    "off by -0.3 mm at 5 mm": (lambda share: one_off(5.0, -0.3 * share), "opens", "slices-resampled"),
    # One gap: twice the limit of a slice off the grid.
    "gap longer by a fifth of 1 mm": (lambda share: longer_gap(1.0, share, 0.1), "opens", "slices-resampled"),
    "gap shorter by a fifth of 1 mm": (lambda share: longer_gap(1.0, share, 0.1, -1), "opens", "slices-resampled"),
    "gap longer by 0.6 mm at 5 mm": (lambda share: longer_gap(5.0, share, 0.3), "opens", "slices-resampled"),
    # Shift perpendicular to the normal: limit of 0.1 mm, or a tenth of the smaller pixel side.
    "sideways 0.1 mm at 0.7 mm pixels": (lambda share: sideways(0.1 * share, (0.7, 0.7)), "opens", "shifted"),
    "sideways -0.1 mm along y": (lambda share: sideways(-0.1 * share, (0.7, 0.7), axis=1), "opens", "shifted"),
    "sideways 0.15 mm at 1.5 mm pixels": (lambda share: sideways(0.15 * share, (1.5, 2.0)), "opens", "shifted"),
    # Tilt: limit of 0.2 degrees, or 0.1 mm over the height.
    "leaning 0.2 degrees over 299 mm": (lambda share: tilted(0.2 * share, 300), "opens", "tilt-corrected"),
    "leaning -0.2 degrees along y": (lambda share: tilted(-0.2 * share, 300, axis=1), "opens", "tilt-corrected"),
    "leaning 0.1 mm over 4 mm": (lambda share: lean(0.1 * share), "opens", "tilt-corrected"),
    # Largest tilt that is corrected.
    "leaning 35 degrees": (lambda share: tilted(35.0 * share, 30), "tilt-corrected", "tilt"),
    # Missing slices: at most 3 in a gap, a gap of at most 10 mm (and the tolerance), a tenth of the slices.
    "gap of 10.6 mm at 5 mm": (lambda share: wide_gap(10.6 * share, 5.0), "slices-interpolated", "irregular"),
    # Uneven distances: at most 4 times the usual one and 10 mm, at least a fifth of the usual one.
    "distance of 4 mm at 1 mm": (lambda share: two_distances(1.0, 4.0 * share), "slices-resampled", "irregular"),
    "distance of 10 mm at 4 mm": (lambda share: two_distances(4.0, 10.0 * share), "slices-resampled", "irregular"),
    "distance of 0.2 mm at 1 mm": (lambda share: short_distance(0.2 / share), "slices-resampled", "irregular"),
    # Position of the far corner of the image: limit of 0.1 mm.
    "rows turned": (lambda share: turned(0.1 * share, "row"), "opens", "mixed"),
    "columns turned": (lambda share: turned(0.1 * share, "column"), "opens", "mixed"),
    "pixels larger along x": (lambda share: stretched(0.1 * share, 0), "opens", "mixed"),
    "pixels smaller along x": (lambda share: stretched(-0.1 * share, 0), "opens", "mixed"),
    "pixels larger along y": (lambda share: stretched(0.1 * share, 1), "opens", "mixed"),
    "pixels smaller along y": (lambda share: stretched(-0.1 * share, 1), "opens", "mixed"),
}


@pytest.mark.parametrize("name", BOUNDS)
def test_each_limit_for_slice_positions_separates_accepted_from_refused_values(name):
    make, inside, outside = BOUNDS[name]
    assert answer(make(INSIDE)) == inside
    assert answer(make(OUTSIDE)) == outside


def test_slice_shifted_by_a_third_of_a_millimetre_is_refused_in_a_straight_stack():
    # The stack is not tilted, so neither limit of the tilt check applies.
    assert answer(sideways(0.3, (0.7, 0.7))) == "shifted"


def test_large_tilt_angle_or_large_shift_alone_is_not_refused_as_gantry_tilt():
    assert answer(lean(0.09, height_mm=2.0)) == "opens"  # 2.6 degrees and 0.09 mm
    assert answer(tilted(0.19, 300)) == "opens"  # 0.99 mm and 0.19 degrees
    assert answer(tilted(0.3, 300)) == "tilt-corrected"


@pytest.mark.parametrize(
    ("rows", "columns", "expected"), [(512, 512, "opens"), (511, 512, "mixed"), (512, 513, "mixed")]
)
def test_series_with_one_slice_of_another_height_or_width_is_refused(rows, columns, expected):
    assert answer(resized(rows, columns)) == expected


@pytest.mark.parametrize(("count", "expected"), [(1, "single-slice"), (2, "opens"), (3, "opens")])
def test_series_of_one_slice_is_refused_and_one_of_two_slices_opens(count, expected):
    assert answer(stack(heights(*[1.0] * (count - 1)))) == expected


@pytest.mark.parametrize(("count", "missing", "good"), [(30, 3, True), (29, 3, False), (20, 3, False), (60, 4, False)])
def test_missing_slices_are_interpolated_up_to_their_largest_number_and_share(count, missing, good):
    gaps = [1.0] * (count - missing - 1)
    gaps[7] = 1.0 + missing
    assert answer(stack(heights(*gaps))) == ("slices-interpolated" if good else "irregular")


@pytest.mark.parametrize(("missing", "text"), [(4, "4 slices may be missing"), (6, "6 slices may be missing")])
def test_number_of_missing_slices_is_stated_in_the_refusal(missing, text):
    gaps = [1.0] * 20
    gaps[7] = 1.0 + missing
    with pytest.raises(VolumeImportError, match=rf"found {gaps[7]:.2f} mm after slice 8 of 21 \(IM007\).*{text}"):
        grid_from_slices(stack(heights(*gaps)), what="reading a series")


def test_affine_matrix_of_a_series_has_the_positions_of_the_slices_and_their_tilt():
    slices = stack(heights(*[1.25] * 8), spacing=(0.7, 0.9))
    for n, one in enumerate(slices):
        one.position_lps = tuple(ORIGIN_LPS + n * np.array([0.002, -0.001, 1.25]))
    found = grid_from_slices(slices[::-1], what="reading a series")
    assert list(found.slices) == slices
    assert found.notes == ()
    expected = np.eye(4)
    expected[:3] = np.stack([(0.7, 0, 0), (0, 0.9, 0), (0.002, -0.001, 1.25), ORIGIN_LPS], axis=1)
    np.testing.assert_allclose(found.lps_from_ijk, expected, rtol=0, atol=1e-12)


def test_slice_gap_of_a_fractional_number_of_slices_is_resampled():
    gaps = [1.0] * 20
    gaps[7] = 2.5
    (note,) = grid_from_slices(stack(heights(*gaps)), what="reading a series").notes
    assert "another one after slice 8)" in note.words
    assert note.badge


def test_number_of_further_irregular_slice_gaps_is_stated():
    gaps = [1.0] * 20
    gaps[7] = gaps[11] = 14.5
    with pytest.raises(VolumeImportError, match=r"\(and at 1 more places\)"):
        grid_from_slices(stack(heights(*gaps)), what="reading a series")


@pytest.mark.parametrize(("count", "expected"), [(4, "irregular"), (5, "slices-resampled")])
def test_uneven_stack_of_few_slices_is_refused(count, expected):
    assert answer(stack(heights(*[1.0, 1.0, 1.0, 1.6][5 - count :]))) == expected


@pytest.mark.parametrize("num_pairs", [3, 12])
def test_slices_of_two_mixed_scans_are_refused(num_pairs):
    """Two scans of 2.5 mm, displaced by 0.8 mm, that overlap in a part of the stack."""
    gaps = [2.5] * (30 - num_pairs) + [0.8, 1.7] * num_pairs
    with pytest.raises(VolumeImportError, match="two distances alternate"):
        grid_from_slices(stack(heights(*gaps)), what="reading a series")


def header(shape=(3, 3, 3), matrix=None, components=1) -> GridHeader:
    """Return a header of a grid file with the given shape, matrix and number of components."""
    return GridHeader(
        format="nrrd",
        shape_ijk=shape,
        num_components=components,
        dtype=np.dtype("<i2"),
        lps_from_ijk=np.eye(4) if matrix is None else matrix,
        data_path=Path("ct.nrrd"),
        data_offset=0,
        compression=None,
    )


@pytest.mark.parametrize(
    ("given", "code"),
    [
        (header(), None),
        (header((2, 2, 2)), None),
        (header((1, 3, 3)), "import.single-slice"),
        (header((3, 3, 1)), "import.single-slice"),
        (header((0, 3, 3)), "import.header"),
        (header((3, -1, 3)), "import.header"),
        (header((3, 3)), "import.not-3d"),
        (header((3, 3, 3, 2)), "import.not-3d"),
        (header(components=2), "import.not-3d"),
        (header(components=0), "import.not-3d"),
        (header(matrix=np.diag([0.01, 1, 1, 1])), None),
        (header(matrix=np.diag([0.01 * INSIDE, 1, 1, 1])), "import.geometry.spacing"),
        (header(matrix=np.diag([1, 1, 100.0, 1])), None),
        (header(matrix=np.diag([1, 1, 100.0 * OUTSIDE, 1])), "import.geometry.spacing"),
        (header(matrix=np.diag([1, 1, np.nan, 1])), "import.geometry.spacing"),
        (header(matrix=np.diag([1, np.inf, 1, 1])), "import.geometry.spacing"),
    ],
)
def test_each_limit_of_a_grid_header_separates_accepted_from_refused_values(given, code):
    if code is None:
        check_grid_header(given.data_path, given)
        return
    with pytest.raises(VolumeImportError) as caught:
        check_grid_header(given.data_path, given)
    assert caught.value.code == code


@pytest.mark.parametrize(
    ("widest_mm", "generation"),
    # At each limit, the airway diameter of Weibel is the root of the squares of 1.5 mm and 0.95 times the spacing.
    [(0.5, 8), (1.157, 8), (1.158, 7), (1.835, 7), (1.836, 6), (18.88, 0), (30.0, 0)],
)
def test_trusted_airway_generation_changes_at_each_voxel_size_limit(widest_mm, generation):
    assert trusted_generation((0.5, 0.5, widest_mm)) == generation
    assert trusted_generation((widest_mm, 0.5, 0.5)) == generation
