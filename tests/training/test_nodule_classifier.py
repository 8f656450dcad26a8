"""Tests of the classifier that compares inserted with real boundaries in ``carina_bench.inserted_nodules``."""

from __future__ import annotations

import numpy as np
import pytest

from carina_bench.inserted_nodules import (
    CLASSES,
    FEATURES,
    area_under_curve,
    centred,
    cross_validated_scores,
    report_classes,
)


def samples(rng, shift, num=30, cts=3):
    """Return samples of some CTs, which differ strongly from each other, shifted in the last feature."""
    rows = []
    for number in range(num):
        ct = number % cts
        row = rng.normal(0.0, 1.0, len(FEATURES)) + 20.0 * ct
        row[-1] += shift
        rows.append((ct, number, row))
    return rows


def test_area_under_curve_is_the_probability_of_a_higher_score():
    assert area_under_curve(np.array([2.0, 3.0, 0.0, 1.0]), np.array([1.0, 1.0, 0.0, 0.0])) == 1.0
    assert area_under_curve(np.array([1.0, 1.0, 1.0, 1.0]), np.array([1.0, 1.0, 0.0, 0.0])) == 0.5
    assert area_under_curve(np.array([0.0, 2.0, 1.0]), np.array([1.0, 1.0, 0.0])) == 0.5


def test_differences_between_cts_are_removed_and_those_of_the_classes_stay():
    rng = np.random.default_rng(3)
    ours, theirs = centred(samples(rng, 2.0), samples(rng, 0.0))
    assert np.abs(np.concatenate([ours, theirs]).mean(axis=0)).max() < 1e-9
    assert ours[:, -1].mean() - theirs[:, -1].mean() == pytest.approx(2.0, abs=0.7)


def test_sample_is_scored_by_a_classifier_that_was_fitted_without_its_fold():
    features, labels = np.arange(10.0)[:, None], np.repeat([0.0, 1.0], 5)
    groups = np.arange(10)
    first = cross_validated_scores(features, labels, groups)
    changed = labels.copy()
    changed[[0, 5]] = 1.0 - changed[[0, 5]]
    # The samples 0 and 5 are one fold: their labels do not change their own scores.
    again = cross_validated_scores(features, changed, groups)
    assert again[[0, 5]] == pytest.approx(first[[0, 5]])
    assert not np.allclose(again[[1, 6]], first[[1, 6]])


def test_classifier_finds_a_shift_of_one_feature_and_none_without_a_shift(capsys):
    rng = np.random.default_rng(5)
    shifts = {"matched": 0.0, "unmatched": 4.0, "real": 0.0, "real again": 0.0}
    areas = report_classes({name: samples(rng, shifts[name], num=120) for name in CLASSES})
    assert areas["unmatched"] > 0.95
    assert 0.35 < areas["matched"] < 0.65
    assert "unmatched" in capsys.readouterr().out
