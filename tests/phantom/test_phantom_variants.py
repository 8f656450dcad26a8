"""Tests of anatomical variants of the phantom: the truth, and the names that Carina gives to the true tree."""

from __future__ import annotations

import functools

import numpy as np
import pytest

import carina
from carina.errors import UsageError
from carina.phantom import VARIANTS
from carina.track import AirwayTree, name_tree

SEEDS = range(20)
RIGHT = {f"RB{n}" for n in range(1, 11)}
LEFT = {"LB1+2", *(f"LB{n}" for n in (3, 4, 5, 6, 8, 9, 10))}
ISOMERIC = {f"R{name[1:]}" for name in LEFT}
CHANGED = {
    "tracheal-bronchus": RIGHT,
    "subsuperior": RIGHT | {"RB*"},
    "absent-rb7": RIGHT - {"RB7"},
    "trifurcations": RIGHT,
    "left-isomerism": ISOMERIC,
}
"""Segments of the right lung with each variant."""


@functools.cache
def true_tree(seed: int, variant: str | None) -> AirwayTree:
    """Return the exact tree of a phantom that has almost no voxels."""
    box = ((-10.0, -10.0, -10.0), (10.0, 10.0, 10.0))
    return AirwayTree.from_json(carina.generate_phantom(seed=seed, spacing_mm=5.0, box_lps=box, variant=variant).truth)


def segments_of(tree: AirwayTree, variant: str) -> set[str]:
    """Return the names of the segments of a true tree; a stem of two segments is no segment."""
    whole = {"LB1+2", *({"RB1+2"} if variant == "left-isomerism" else ())}
    return {name for name in tree.names if name[1:2] == "B" and ("+" not in name or name in whole)}


@pytest.mark.parametrize("variant", sorted(CHANGED))
def test_truth_has_the_segments_of_the_variant_and_no_others(variant):
    for seed in SEEDS:
        made = true_tree(seed, variant)
        assert segments_of(made, variant) == CHANGED[variant] | LEFT, seed


def test_ground_truth_of_each_variant_has_the_bronchi_at_their_origins():
    for seed in SEEDS:
        tracheal = true_tree(seed, "tracheal-bronchus")
        above = tracheal.branch(tracheal.named("RB1").parent or 0)
        assert above.name == "Trachea"
        assert 15.0 < above.tip_lps[2] < 25.0
        assert {tracheal.branch(c).name for c in tracheal.named("RUL").children} == {"RB2", "RB3"}
        assert np.allclose(tracheal.named("RMB").points[0], 0.0)

        subsuperior = true_tree(seed, "subsuperior")
        assert subsuperior.branch(subsuperior.named("RB*").parent or 0).name == "Right basal trunk"

        three = true_tree(seed, "trifurcations")
        assert len(three.named("RUL").children) == len(three.named("Left basal trunk").children) == 3

        isomeric = true_tree(seed, "left-isomerism")
        right, left = (isomeric.named(name).length_mm for name in ("RMB", "LMB"))
        assert right == pytest.approx(left, rel=0.25)
        assert "BI" not in isomeric.names
        assert {isomeric.branch(c).name for c in isomeric.named("RMB").children} == {"RUL", "RLL"}


@pytest.mark.parametrize("variant", sorted(CHANGED))
def test_names_given_to_the_true_tree_equal_the_truth(variant):
    """Over 20 seeds at least 95 % of the segments are named right and at most 3 % wrong."""
    right = wrong = total = 0
    for seed in SEEDS:
        truth = true_tree(seed, variant)
        named = name_tree(truth)
        segments = segments_of(truth, variant)
        for true, found in zip(truth.branches, named.branches, strict=True):
            if true.name in segments:
                total += 1
                right += found.name == true.name
                wrong += found.name not in {true.name, None}
    assert right >= 0.95 * total, (right, wrong, total)
    assert wrong <= 0.03 * total, (right, wrong, total)


@pytest.mark.parametrize(
    ("variant", "name", "text"),
    [
        ("tracheal-bronchus", "RB1", "tracheal bronchus"),
        ("subsuperior", "RB*", "subsuperior bronchus"),
        ("left-isomerism", "Trachea", "left isomerism"),
    ],
)
def test_naming_reports_the_variant(variant, name, text):
    found = 0
    for seed in SEEDS:
        truth = true_tree(seed, variant)
        pairs = zip(truth.branches, name_tree(truth).branches, strict=True)
        # A bronchus whose name is uncertain has the note, too.
        found += any(text in (branch.variant or "") for true, branch in pairs if true.name == name)
    assert found >= 18


def test_naming_reports_no_isomerism_in_other_trees():
    for variant in (None, *VARIANTS):
        if variant != "left-isomerism":
            for seed in range(8):
                assert "isomerism" not in (name_tree(true_tree(seed, variant)).root.variant or "")


def test_published_variants_are_drawn_by_the_seed_and_listed_in_the_truth():
    box = ((-10.0, -10.0, -10.0), (10.0, 10.0, 10.0))
    drawn = [
        carina.generate_phantom(seed=seed, spacing_mm=5.0, generations=3, box_lps=box, variant="published").truth
        for seed in range(40)
    ]
    listed = [set(truth["variants"]) for truth in drawn]
    assert any(listed)
    assert sum(bool(one) for one in listed) < 25
    for truth, variants in zip(drawn, listed, strict=True):
        names = {branch["name"] for branch in truth["branches"]}
        assert ("RB*" in names) == ("subsuperior" in variants)
        assert ("RB7" not in names) == ("absent-rb7" in variants or "left-isomerism" in variants)
    assert "variants" not in carina.generate_phantom(spacing_mm=5.0, generations=3, box_lps=box).truth


@pytest.mark.parametrize("variant", sorted(CHANGED))
def test_airways_found_in_the_ct_of_a_variant_have_the_true_trunks(variant):
    made = carina.generate_phantom(seed=2, spacing_mm=1.5, generations=5, variant=variant)
    airways = carina.find_airways(made.volume)
    truth = AirwayTree.from_json(made.truth)
    every = np.concatenate([branch.points for branch in airways.tree.branches])
    for name in ("RMB", "LMB", "RUL", "RLL", "LUL", "LLL"):
        middle = truth.named(name).points[len(truth.named(name).points) // 2]
        assert np.linalg.norm(every - middle, axis=1).min() < 3.0, name


def test_variant_with_a_tube_or_a_resected_lobe_or_an_unknown_variant_is_refused():
    for other in ({"tube": "endotracheal"}, {"resected": "RUL"}):
        with pytest.raises(UsageError, match="variant"):
            carina.generate_phantom(spacing_mm=5.0, variant="absent-rb7", **other)
    with pytest.raises(UsageError, match="variant"):
        carina.generate_phantom(spacing_mm=5.0, variant="situs-inversus")
