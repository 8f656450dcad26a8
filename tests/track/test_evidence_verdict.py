"""Tests of the evidence verdict along a path, against a plain implementation of its rule."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from carina.track.edit import evidence_verdict as verdict
from carina.track.edit.evidence_verdict import LungBaseline, PathStart, Sections, doubtful_sections, gains
from carina.track.intensity_levels import AirScale

HU = AirScale(air=-1000.0, tissue=0.0)
LUNG = LungBaseline(rise=40.0, far_rise=90.0, bright=-850.0)


def made(seed, num):
    rng = np.random.default_rng(seed)
    rise = rng.uniform(0.0, 150.0, num)
    return Sections(
        at_mm=verdict.STEP_MM * np.arange(num),
        middle=rng.uniform(-1000.0, -430.0, num),
        rise=rise,
        far_rise=rise + rng.uniform(0.0, 200.0, num),
        closed=rise * rng.uniform(0.0, 1.0, num),
        far_closed=rise * rng.uniform(0.0, 1.5, num),
        around=rng.uniform(-980.0, -600.0, num),
        radius_mm=rng.uniform(0.3, 3.0, num),
        bend=rng.uniform(0.0, 1.5, num),
    )


def tube(num=40, **changes):
    """Return sections of a clear airway of 1.5 mm radius."""
    values = {
        "middle": -950.0,
        "rise": 150.0,
        "far_rise": 250.0,
        "closed": 120.0,
        "far_closed": 200.0,
        "around": -850.0,
        "radius_mm": 1.5,
        "bend": 0.0,
    }
    fields = {name: np.full(num, value) for name, value in values.items()}
    for name, value in changes.items():
        fields[name] = np.asarray(value, dtype=float) * np.ones(num)
    return Sections(at_mm=verdict.STEP_MM * np.arange(num), **fields)


def one_by_one(sections, lung, start):
    """Return the gain of each section by the rule of the verdict, computed section by section in HU."""
    found = []
    radii = [
        max(radius, 3.0) if rise < lung.rise and closed > lung.far_rise and middle < -930.0 else radius
        for radius, rise, closed, middle in zip(
            sections.radius_mm, sections.rise, sections.far_closed, sections.middle, strict=True
        )
    ]
    for n, at in enumerate(sections.at_mm):
        is_beyond = start is None or at >= min(start.inside_mm, sections.at_mm[-1] - verdict.STEP_MM)
        first = next(
            m
            for m, mm in enumerate(sections.at_mm)
            if start is None or mm >= min(start.inside_mm, sections.at_mm[-1] - verdict.STEP_MM)
        )
        middle = sections.middle[n]
        if middle > verdict.NO_LUMEN_HU:
            found.append(verdict.NO_LUMEN)
            continue
        over = min(middle - min(sections.around[n], lung.bright), 0.0)

        def between(value, least, most):
            return max(least, min(most, value))

        gain = verdict.BASE
        gain += verdict.RISE * between((sections.rise[n] + over) / lung.rise, *verdict.RISE_LIMITS)
        gain += verdict.FAR_RISE * between((sections.far_rise[n] + over) / lung.far_rise, *verdict.FAR_LIMITS)
        gain += verdict.CLOSED * between((sections.closed[n] + over) / lung.rise, *verdict.CLOSED_LIMITS)
        gain += verdict.FAR_CLOSED * between((sections.far_closed[n] + over) / lung.far_rise, *verdict.CLOSED_LIMITS)
        if is_beyond:
            gain += verdict.DROP * between(
                (max(sections.middle[first : n + 1]) - middle) / 100.0, 0.0, verdict.MAX_DROP
            )
        if start is not None:
            mouth = [
                radius
                for mm, radius in zip(sections.at_mm[:first], radii[:first], strict=True)
                if mm > start.inside_mm - verdict.MOUTH_MM
            ]
            wide = max([start.branch_radius_mm, *mouth])
            gain += verdict.WIDER * between(radii[n] / wide - verdict.AS_WIDE, 0.0, verdict.MAX_WIDER)
        gain += verdict.BEND * sections.bend[n]
        gain += verdict.UNEVEN * np.std(radii[max(0, n - 5) : n + 6])
        gain += verdict.GAP * between((radii[n] - 1.0) * (middle + 980.0) / 100.0, 0.0, verdict.MAX_GAP)
        found.append(gain)
    return np.array(found)


@given(seed=st.integers(0, 2**32 - 1), num=st.integers(2, 60), inside_mm=st.one_of(st.none(), st.floats(0.0, 20.0)))
def test_evidence_of_each_path_section_equals_the_plain_rule(seed, num, inside_mm):
    sections = made(seed, num)
    start = None if inside_mm is None else PathStart(inside_mm, 1.3, np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(gains(sections, LUNG, HU, start), one_by_one(sections, LUNG, start), atol=1e-9)


@given(seed=st.integers(0, 2**32 - 1), num=st.integers(2, 60), raised=st.floats(0.0, 200.0))
def test_higher_wall_values_never_make_a_path_section_more_doubtful(seed, num, raised):
    sections = made(seed, num)
    walls = ("rise", "far_rise", "closed", "far_closed")
    fields = {name: getattr(sections, name) for name in Sections.__slots__}
    more = Sections(**{name: value + raised * (name in walls) for name, value in fields.items()})
    # The same sections must have a measurable radius in both cases; wide sections have none.
    assume(np.array_equal(verdict._radii(sections, LUNG, HU), verdict._radii(more, LUNG, HU)))
    assert (gains(more, LUNG, HU) >= gains(sections, LUNG, HU) - 1e-9).all()
    assert not (doubtful_sections(more, LUNG, HU) & ~doubtful_sections(sections, LUNG, HU)).any()


def test_path_without_values_brighter_than_its_middle_has_no_airway_evidence():
    # Lung without noise is straight, even and not too wide, but has no wall.
    plain = tube(middle=-860.0, rise=0.0, far_rise=20.0, closed=0.0, far_closed=0.0, around=-860.0, radius_mm=0.35)
    assert doubtful_sections(plain, LUNG, HU).all()


def test_airway_with_a_wall_along_its_length_has_evidence():
    start = PathStart(0.0, 1.8, np.array([0.0, 0.0, 1.0]))
    assert not doubtful_sections(tube(), LUNG, HU, start).any()


def test_one_bright_wall_is_insufficient_evidence_for_a_long_path_without_walls():
    bare = np.arange(40) >= 12
    sections = tube(
        rise=np.where(bare, 0.0, 1000.0),
        far_rise=np.where(bare, 20.0, 1000.0),
        closed=np.where(bare, 0.0, 1000.0),
        far_closed=np.where(bare, 0.0, 1000.0),
        middle=np.where(bare, -860.0, -950.0),
    )
    found = doubtful_sections(sections, LUNG, HU)
    assert found[14:].all()
    assert not found[:8].any()


@pytest.mark.parametrize(
    "change",
    [
        pytest.param({"middle": -850.0, "radius_mm": 2.0, "closed": 10.0, "rise": 45.0, "far_closed": 50.0}, id="gap"),
        pytest.param({"bend": 1.2, "closed": 10.0, "far_closed": 30.0}, id="bends"),
        pytest.param({"radius_mm": np.tile([0.4, 2.8], 20), "closed": 10.0, "far_closed": 30.0}, id="uneven"),
    ],
)
def test_gap_between_vessels_has_no_airway_evidence_although_most_sides_are_bright(change):
    start = PathStart(0.0, 1.0, np.array([0.0, 0.0, 1.0]))
    usual = gains(tube(), LUNG, HU, start)
    assert (gains(tube(**change), LUNG, HU, start) < usual - 2.0).all()


def test_path_sections_beyond_a_crossed_wall_are_doubtful():
    middle = np.full(40, -980.0)
    middle[10:14] = [-800.0, -600.0, -600.0, -800.0]
    found = doubtful_sections(tube(middle=middle), LUNG, HU)
    assert found[11:].all()


def test_main_bronchus_has_evidence_although_its_walls_are_outside_the_measured_distance():
    noise = np.random.default_rng(3)
    wide = tube(
        middle=-985.0 + noise.normal(0.0, 5.0, 40),
        rise=np.abs(noise.normal(0.0, 3.0, 40)),
        closed=0.0,
        far_rise=900.0,
        far_closed=850.0,
        radius_mm=noise.choice([0.0, 3.15], 40),
    )
    assert not doubtful_sections(wide, LUNG, HU, PathStart(0.0, 5.5, np.array([0.0, 0.0, 1.0]))).any()


def test_path_through_values_as_bright_as_tissue_has_no_airway_evidence():
    middle = np.full(40, -900.0)
    middle[20] = -440.0
    found = doubtful_sections(tube(middle=middle), LUNG, HU)
    assert found[20]
