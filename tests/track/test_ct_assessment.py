"""Tests that the assessment of a CT names the one degradation of a phantom, and nothing else."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from cached_test_data import cached_phantom
from carina.errors import UsageError
from carina.track import assess_ct, ct_assessment
from carina.volume import Volume, quality
from carina_bench.track_gate import DEGRADATIONS, OPTIONS, named_codes

SEED = 411
"""Seed of the phantom, which was not used for the choice of the limits."""


@pytest.fixture(scope="module")
def plain():
    return cached_phantom(**OPTIONS, seed=SEED)


# A tube is recognised from the airways that were found (benchmark `track --only gate`).
@pytest.mark.parametrize("name", sorted(DEGRADATIONS.keys() - {"tube"}))
def test_only_the_degradation_of_a_phantom_is_named(plain, name):
    found = assess_ct(DEGRADATIONS[name](plain.volume, SEED))
    assert named_codes(found.findings) == ([] if name == "none" else [name])


def test_noise_is_measured_within_a_tenth(plain):
    quality = assess_ct(DEGRADATIONS["noise"](plain.volume, SEED)).quality
    assert quality.noise_hu == pytest.approx(85.0, rel=0.1)


def test_more_noise_and_thicker_slices_never_raise_the_trusted_generation(plain):
    trusted = {name: assess_ct(DEGRADATIONS[name](plain.volume, SEED)).trusted_generation for name in DEGRADATIONS}
    assert trusted["noise"] < trusted["none"]
    assert trusted["slices"] < trusted["none"]


def test_assessment_does_not_depend_on_the_order_of_the_axes(plain):
    volume = DEGRADATIONS["motion"](plain.volume, SEED)
    matrix = volume.lps_from_ijk.copy()
    matrix[:3, 3] += matrix[:3, 2] * (volume.shape_zyx[0] - 1)
    matrix[:3, 2] *= -1
    turned = Volume(np.ascontiguousarray(volume.hu_zyx[::-1]), matrix)
    assert named_codes(assess_ct(turned).findings) == ["motion"]


def test_volume_that_is_not_in_hu_is_refused():
    with pytest.raises(UsageError) as caught:
        assess_ct(Volume(np.zeros((4, 4, 4), np.int16), np.eye(4), is_hu=False, not_hu_reason="a mask"))
    assert caught.value.code == "usage.not-hu"


def test_every_finding_of_the_quality_gate_belongs_to_a_property_of_the_statement():
    source = Path(quality.__file__).read_text()
    codes = set(re.findall(r'Finding\(\s*"([a-z-]+)"', source)) - {"not-hu", "mask"}  # only a CT in HU is assessed
    assert codes <= {code for part in ct_assessment._CODES.values() for code in part}


def test_motion_is_not_measurable_in_a_ct_without_lungs():
    tissue = Volume(np.full((20, 40, 40), 40, dtype=np.int16), np.diag([2.0, 2.0, 2.0, 1.0]))
    (motion,) = [one for one in assess_ct(tissue).statement if one.name == "motion"]
    assert motion.words.startswith("not measurable")
