"""Tests of the drawings of a report: outlines, surfaces, slices, tissues on the needle path, tree, clock."""

from __future__ import annotations

import dataclasses
import itertools
from typing import get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from nodules import ellipsoid
from phantom_plan import plan, sheet

from carina.plan import tool
from carina.plan.report.drawing import Disc, Label, Raster, Stroke, svg
from carina.plan.report.figures import needle_bar, slice_drawing, tree_drawing
from carina.plan.report.outline import boundary_in_plane, surface_of
from carina.plan.report.tracing import tracing_drawings
from carina.plan.report.wording import lines_of, text_width
from carina.plan.routes.last_leg import CrossedTissue, Tissue

radii = st.tuples(*[st.floats(3.0, 12.0)] * 3)
UNIT = st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda v: np.linalg.norm(v) > 0.3)


def plane(normal: tuple[float, float, float], centre: np.ndarray, mm_per_px: float, size: int) -> np.ndarray:
    """Return the matrix of an oblique picture plane whose middle is ``centre``."""
    into = np.array(normal) / np.linalg.norm(normal)
    right = np.cross(into, np.eye(3)[int(np.argmin(np.abs(into)))])
    right /= np.linalg.norm(right)
    down = np.cross(into, right)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([right * mm_per_px, down * mm_per_px, into], axis=1)
    matrix[:3, 3] = centre - 0.5 * size * (matrix[:3, 0] + matrix[:3, 1])
    return matrix


@settings(max_examples=20, deadline=None)
@given(radii_mm=radii, normal=UNIT)
def test_outline_of_an_ellipsoid_is_on_its_surface_in_any_plane(radii_mm, normal) -> None:
    nodule = ellipsoid(radii_mm)
    centre, mm_per_px, size = np.array(nodule.centre_lps), 0.15, 240
    matrix = plane(normal, centre, mm_per_px, size)
    (line,) = boundary_in_plane(nodule, matrix, size, size)
    assert np.array_equal(line[0], line[-1])
    points = line @ matrix[:3, :2].T + matrix[:3, 3]
    scaled = (points - centre) / np.array(radii_mm)
    # The distance to the surface is approximated to first order; the tolerance is half a voxel of the nodule's box and
    # the step of the plane.
    off = (np.linalg.norm(scaled, axis=1) - 1.0) / np.linalg.norm(scaled / np.array(radii_mm), axis=1)
    assert np.abs(off).max() < 0.45
    assert abs(float(np.median(off))) < 0.12
    turn = np.unwrap(np.arctan2(*(line - size / 2).T))
    assert abs(abs(turn[-1] - turn[0]) - 2.0 * np.pi) < 1e-6, "it goes round once"


@settings(max_examples=10, deadline=None)
@given(radii_mm=radii)
def test_surface_of_an_ellipsoid_is_closed_and_has_its_volume(radii_mm) -> None:
    vertices, quads = surface_of(ellipsoid(radii_mm))
    edges = {}
    for quad in quads.tolist():
        for edge in itertools.pairwise([*quad, quad[0]]):
            edges[frozenset(edge)] = edges.get(frozenset(edge), 0) + 1
    assert set(edges.values()) <= {2, 4}
    corners = vertices[quads] - vertices.mean(axis=0)
    halves = (corners[:, [0, 1, 2]], corners[:, [0, 2, 3]])
    volume = sum(float(np.einsum("ij,ij->i", h[:, 0], np.cross(h[:, 1], h[:, 2])).sum()) for h in halves) / 6.0
    # Coarse cells cut corners of the surface, which reduces the volume.
    assert volume == pytest.approx(4.0 / 3.0 * np.pi * np.prod(radii_mm), rel=0.12)


def test_slices_show_the_target_in_the_middle_with_correct_sides() -> None:
    report = sheet()
    letters = {one.title: one.letters for one in report.slices}
    assert letters == {
        "Axial": ("R", "L", "A", "P"),
        "Coronal": ("R", "L", "S", "I"),
        "Sagittal": ("A", "P", "S", "I"),
    }
    nodule, leg = report.plan.nodule, report.plan.routes[0].leg
    off = np.array(leg.tip_lps) - np.array(nodule.centre_lps)
    axes = {"Axial": (0, 1, 1), "Coronal": (0, 2, -1), "Sagittal": (1, 2, -1)}
    for one in report.slices:
        (outline,) = [np.array(line) for line in one.target]
        width_mm = np.ptp(outline, axis=0) * one.mm_per_px
        assert np.abs(outline.mean(axis=0) - one.width_px / 2).max() * one.mm_per_px < 1.5
        assert 0.8 * nodule.short_mm < width_mm.min() <= width_mm.max() < 1.2 * nodule.long_mm
        across, down, sign = axes[one.title]
        middle = np.array([one.width_px, one.height_px]) / 2
        assert np.allclose((np.array(one.tip) - middle) * one.mm_per_px, [off[across], sign * off[down]], atol=0.01)


def test_slice_along_the_needle_contains_tip_aim_and_target() -> None:
    one = sheet().needle_slice
    leg = plan().routes[0].leg
    assert one is not None and [lies_in for _, lies_in in one.needle] == [True]
    (start, end), _ = one.needle[0]
    length = np.linalg.norm(np.array(leg.aim_lps) - np.array(leg.tip_lps))
    assert (end[0] - start[0]) * one.mm_per_px == pytest.approx(length, abs=0.01) and start[1] == pytest.approx(end[1])
    outline = np.array(one.target[0])
    assert outline[:, 0].min() < end[0] < outline[:, 0].max()
    edge_mm = (outline[np.argsort(np.abs(outline[:, 1] - end[1]))[:6], 0].min() - start[0]) * one.mm_per_px
    assert edge_mm == pytest.approx(leg.to_target_mm, abs=0.8)


def test_needle_outside_the_slice_is_dotted() -> None:
    report = sheet()
    leg = report.plan.routes[0].leg
    centre, tip, aim = (np.array(place) for place in (report.plan.nodule.centre_lps, leg.tip_lps, leg.aim_lps))
    share = np.linspace(0.0, 1.0, 2001)[:, None]
    off = np.abs(tip + share * (aim - tip) - centre)
    for one, axis in zip(report.slices, (2, 1, 0), strict=True):
        in_plane = sum(np.linalg.norm(np.subtract(*piece)) for piece, lies_in in one.needle if lies_in)
        whole = sum(np.linalg.norm(np.subtract(*piece)) for piece, _ in one.needle)
        near = float((off[:, axis] <= 1.5).mean())
        assert in_plane / whole == pytest.approx(near, abs=0.05)
        dashes = [s.pen.dash for s in slice_drawing(one).shapes if isinstance(s, Stroke) and s.pen.width == 3.0]
        assert any(dash is not None for dash in dashes) == (near < 0.97)


TISSUES = get_args(Tissue)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.sampled_from(TISSUES), st.floats(0.5, 20.0)), min_size=1, max_size=9))
def test_bar_of_tissues_along_the_needle_is_to_scale_without_overlapping_labels(parts) -> None:
    at, crossed = 0.0, []
    for tissue, length in parts:
        crossed.append(CrossedTissue(tissue, at, length))
        at += length
    leg = plan().routes[0].leg
    drawing = needle_bar(dataclasses.replace(leg, crossed=tuple(crossed)), tool("needle-21g"))
    boxes = [s for s in drawing.shapes if isinstance(s, Stroke) and s.closed]
    widths = [box.places[1][0] - box.places[0][0] for box in boxes]
    scale = (drawing.width - 20.0) / max(at, 15.0)
    assert widths == pytest.approx([one.length_mm * scale for one in crossed])
    names = [s for s in drawing.shapes if isinstance(s, Label) and s.size == 8.5]
    assert [name.text.rsplit(" ", 1)[0] for name in names] == [one.tissue for one in crossed]
    for one, other in itertools.combinations(names, 2):
        if one.at[1] == other.at[1]:
            assert abs(one.at[0] - other.at[0]) >= 0.5 * (text_width(one.text, 8.5) + text_width(other.text, 8.5)) - 0.5
    assert all(0.0 <= label.at[1] <= drawing.height for label in drawing.shapes if isinstance(label, Label))


def test_tree_from_the_front_has_the_patient_right_on_the_left() -> None:
    report = sheet()
    shapes = tree_drawing(report.shape, report.forks, "front", width=255.0, height=160.0).shapes
    target = [s for s in shapes if isinstance(s, Stroke) and s.closed and s.pen.opacity < 1.0]
    trachea = report.shape.route_lps[0]
    left_of_trachea = np.mean([x for x, _ in target[0].places]) < 127.5
    assert left_of_trachea == (report.plan.nodule.centre_lps[0] < trachea[0])
    forks = [s for s in shapes if isinstance(s, Disc)]
    assert 1 <= len(forks) <= len(report.forks)


def test_branch_drawn_by_hand_is_red_and_dashed_in_the_tree() -> None:
    report = sheet()
    first = report.shape.branches[-1]
    changed = dataclasses.replace(first, is_found=False)
    shape = dataclasses.replace(report.shape, branches=(*report.shape.branches[:-1], changed))
    strokes = [s for s in tree_drawing(shape, (), "left", width=255.0, height=160.0).shapes if isinstance(s, Stroke)]
    assert [s.pen.line for s in strokes].count("#c1001f") == 1
    assert all(s.pen.dash is not None for s in strokes if s.pen.line == "#c1001f")


def test_clock_face_shows_the_opening_at_its_hour() -> None:
    report = sheet()
    (drawing,) = tracing_drawings(report)
    faces = [s for s in drawing.shapes if isinstance(s, Disc) and s.middle[0] == 170.0 and s.pen.line == "#14181c"]
    filled = [s for s in drawing.shapes if isinstance(s, Disc) and s.pen.fill == "#0b5a8f"]
    openings = [s for s in filled if 150 < s.middle[0] < 190 and s.radius != 3.6]
    assert len(faces) == len(openings) == len(report.forks)
    for fork, face, opening in zip(report.forks, faces, openings, strict=True):
        x, y = np.array(opening.middle) - np.array(face.middle)
        if fork.turn.straight_ahead:
            assert (x, y) == (0.0, 0.0)
            continue
        hours = np.degrees(np.arctan2(x, -y)) / 30.0 % 12.0
        assert hours == pytest.approx(fork.turn.clock_head % 12.0)


@pytest.mark.parametrize("hour", [2.0, 9.0])
def test_names_beside_the_diagram_stay_on_the_page(hour) -> None:
    report = sheet()
    turn = dataclasses.replace(report.forks[0].turn, clock_head=hour, straight_ahead=False, hour_doubt=None)
    fork = dataclasses.replace(report.forks[0], turn=turn, others=("Upper division", "Right basal trunk"))
    (drawing,) = tracing_drawings(dataclasses.replace(report, forks=(fork,) * 4))
    labels = [s for s in drawing.shapes if isinstance(s, Label)]
    assert sum(one.text.startswith(("Upper", "Right b")) for one in labels) >= 8
    for one in labels:
        width = text_width(one.text, one.size, is_bold=one.bold)
        left = one.at[0] - {"start": 0.0, "middle": 0.5, "end": 1.0}[one.anchor] * width
        assert left >= -0.5 and left + width <= drawing.width + 0.5, one.text


def test_drawn_branch_that_extends_a_tip_is_red_in_the_row_of_the_tip() -> None:
    report = sheet()
    doubt = "branch 145 was drawn by hand"
    route = dataclasses.replace(report.route, doubts=(doubt,))
    changed = dataclasses.replace(
        report, plan=dataclasses.replace(report.plan, routes=(route, *report.plan.routes[1:]))
    )
    (drawing,) = tracing_drawings(changed)
    (label,) = (s for s in drawing.shapes if isinstance(s, Label) and s.text == doubt)
    assert label.colour == "#c1001f"
    line = [s.pen.line for s in drawing.shapes if isinstance(s, Stroke) and s.pen.width == 2.2]
    assert line[-1] == "#c1001f"


@given(st.lists(st.text("abc", min_size=1, max_size=12), max_size=30), st.floats(80.0, 300.0))
def test_wrapped_text_lines_contain_every_word_and_fit_the_width(message, width) -> None:
    lines = lines_of(" ".join(message), 9.0, width)
    assert " ".join(lines).split() == message
    assert all(text_width(line, 9.0) <= width or " " not in line for line in lines)


def test_svg_escapes_text_and_has_no_style_attribute() -> None:
    plain = slice_drawing(sheet().slices[0])
    nasty = dataclasses.replace(plain, shapes=(*plain.shapes, Label((1.0, 1.0), '<script>"&')), says='"><x>')
    text = svg(nasty)
    assert "<script>" not in text and "<x>" not in text and " style=" not in text
    assert sum(isinstance(shape, Raster) for shape in plain.shapes) == text.count("<image")


def test_route_drawn_by_hand_is_red_in_tree_and_tracing_sheet() -> None:
    report = sheet()
    drawn = report.forks[2]
    branches = tuple(dataclasses.replace(b, is_found=b.id != drawn.to_branch_id) for b in report.shape.branches)
    tree = tree_drawing(dataclasses.replace(report.shape, branches=branches), (), "front", width=255.0, height=160.0)
    strokes = [s for s in tree.shapes if isinstance(s, Stroke)]
    blue = next(n for n, s in enumerate(strokes) if s.pen.line == "#0b5a8f")
    assert any(s.pen.line == "#c1001f" and s.pen.width == 2.4 for s in strokes[blue:]), "over the blue line"
    warned = dataclasses.replace(drawn, warnings=("RML was drawn by hand",))
    changed = dataclasses.replace(report, forks=(*report.forks[:2], warned, *report.forks[3:]))
    (page,) = tracing_drawings(changed)
    line = [s.pen.line for s in page.shapes if isinstance(s, Stroke) and s.pen.width == 2.2]
    assert line == ["#0b5a8f"] * 3 + ["#c1001f"] + ["#0b5a8f"] * (len(report.forks) - 3)
