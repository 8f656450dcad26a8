"""Tests of bronchus names in true phantom trees: rotated, mirrored, pruned, cropped, or with additional twigs."""

from __future__ import annotations

import dataclasses
import functools
import math

import numpy as np
import pytest

from carina.phantom import generate_phantom
from carina.track import AirwayTree, Branch, LetterRule, branch_side_and_lobe, name_tree, name_words
from carina.track.names.anatomy_model import LOBES, grammar
from carina.track.names.assignment import Solver, probability_of_one_segment
from carina.track.names.letters import letter_order
from carina.track.names.tree_shape import bronchi_of, find_lungs

SEEDS = range(1, 7)
LOBE_OF = {
    **dict.fromkeys(("RUL", "RB1", "RB2", "RB3", "RB1+2", "RB2+3"), "RUL"),
    **dict.fromkeys(("RML", "RB4", "RB5"), "RML"),
    **dict.fromkeys(("RLL", "RB6", "RB7", "RB8", "RB9", "RB10", "RB9+10", "Right basal trunk"), "RLL"),
    **dict.fromkeys(("LUL", "LB1+2", "LB3", "LB4", "LB5", "Lingula", "Upper division"), "LUL"),
    **dict.fromkeys(("LLL", "LB6", "LB8", "LB9", "LB10", "LB9+10", "Left basal trunk"), "LLL"),
}


@functools.cache
def true_tree(seed: int) -> AirwayTree:
    """Return the exact tree of a phantom that has almost no voxels."""
    box = ((-10.0, -10.0, -10.0), (10.0, 10.0, 10.0))
    return AirwayTree.from_json(generate_phantom(seed=seed, spacing_mm=5.0, box_lps=box).truth)


def is_segment(name: str | None) -> bool:
    return name is not None and name[1:2] == "B" and (name == "LB1+2" or "+" not in name)


def moved(tree: AirwayTree, matrix: np.ndarray, offset: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> AirwayTree:
    """Return the tree with each point x moved to ``matrix`` x + ``offset``, and with radii scaled accordingly."""
    scale = abs(float(np.linalg.det(matrix))) ** (1 / 3)
    return AirwayTree(
        tuple(
            dataclasses.replace(b, points=b.points @ matrix.T + np.array(offset), radius=b.radius * scale)
            for b in tree.branches
        )
    )


def turned(axis: tuple[float, float, float], deg: float) -> np.ndarray:
    k = np.array(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]])
    a = math.radians(deg)
    return np.eye(3) + math.sin(a) * cross + (1 - math.cos(a)) * cross @ cross


def rooted_at(tree: AirwayTree, name: str) -> AirwayTree:
    """Return the branch ``name`` and its descendants as a separate tree."""
    root = tree.named(name)
    below = {root.id}
    for b in tree.branches:
        if b.parent in below:
            below.add(b.id)
    return AirwayTree(
        tuple(
            dataclasses.replace(b, parent=None if b is root else b.parent, generation=b.generation - root.generation)
            for b in sorted((b for b in tree.branches if b.id in below), key=lambda b: (b is not root, b.id))
        )
    )


def without(tree: AirwayTree, cut: set[int]) -> AirwayTree:
    """Return the tree without some branches and their descendants; the IDs of the other branches stay the same."""
    removed: set[int] = set()
    for b in tree.branches:
        if b.id in cut or b.parent in removed:
            removed.add(b.id)
    return AirwayTree(
        tuple(
            dataclasses.replace(b, children=tuple(c for c in b.children if c not in removed))
            for b in tree.branches
            if b.id not in removed
        )
    )


def with_twigs(tree: AirwayTree, rng: np.random.Generator, num: int) -> AirwayTree:
    """Return the tree with short blind tubes on branches, each of which divides its branch in two."""
    branches = {b.id: b for b in tree.branches}
    order = [b.id for b in tree.branches]
    chosen = [b.id for b in tree.branches if len(b.points) > 8 and b.parent is not None]
    for b in (branches[k] for k in chosen[:: max(len(chosen) // num, 1)]):
        mid = len(b.points) // 2
        new, twig = len(branches), len(branches) + 1
        side = rng.normal(size=3)
        side *= (1.5 * b.radius[mid] + 1.0) / np.linalg.norm(side)
        lower = dataclasses.replace(
            b, id=new, parent=b.id, points=b.points[mid:], radius=b.radius[mid:], generation=b.generation + 1
        )
        branches[b.id] = dataclasses.replace(
            b, points=b.points[: mid + 1], radius=b.radius[: mid + 1], children=(new, twig)
        )
        branches[new] = lower
        for child in lower.children:
            branches[child] = dataclasses.replace(branches[child], parent=new)
        branches[twig] = Branch(
            twig, b.id, (), b.generation + 1, None, "tracked",
            np.stack([b.points[mid], b.points[mid] + 0.5 * side, b.points[mid] + side]), np.array([1.0, 0.9, 0.8]),
        )  # fmt: skip
        order.extend([new, twig])
    made: list[Branch] = []
    waiting = [order[0]]
    while waiting:
        made.append(branches[waiting.pop(0)])
        waiting.extend(made[-1].children)
    return AirwayTree(tuple(made))


def score(truth: AirwayTree, named: AirwayTree) -> tuple[int, int, int]:
    """Return the number of segments named right, named wrong, and in total.

    An unnamed segment is neither right nor wrong.
    """
    right = wrong = total = 0
    for b in named.branches:
        true = next((t for t in truth.branches if t.id == b.id), None)
        if true is None or not is_segment(true.name):
            continue
        # If all siblings of a branch were removed, the branch continues its stem and has the stem's name.
        if b.parent is not None and len(named.branch(b.parent).children) == 1:
            continue
        total += 1
        right += b.name == true.name
        wrong += b.name not in {true.name, None}
    return right, wrong, total


def scores(change, *, seeds=SEEDS) -> tuple[float, float]:
    rows = []
    for seed in seeds:
        tree = true_tree(seed)
        rows.append(score(tree, name_tree(change(tree, np.random.default_rng(seed)))))
    right, wrong, total = np.sum(rows, axis=0)
    return right / total, wrong / total


def test_nine_of_ten_segments_of_ground_truth_trees_are_named_correctly():
    right, wrong = scores(lambda tree, _rng: tree)
    assert right >= 0.93
    assert wrong <= 0.05


@pytest.mark.slow
@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, -1)])
@pytest.mark.parametrize("deg", [-25.0, 25.0])
def test_rotated_or_tilted_patient_has_the_same_names(axis, deg):
    right, wrong = scores(lambda tree, _rng: moved(tree, turned(axis, deg), (40.0, -200.0, 900.0)), seeds=range(1, 4))
    assert right >= 0.90
    assert wrong <= 0.07


def test_child_has_the_same_names_as_an_adult():
    for seed in (1, 2, 3):
        tree = true_tree(seed)
        adult, child = name_tree(tree), name_tree(moved(tree, 0.6 * np.eye(3)))
        assert [b.name for b in adult.branches] == [b.name for b in child.branches]


@pytest.mark.slow
def test_tree_with_missing_branches_has_few_wrong_names():
    def prune(tree: AirwayTree, rng: np.random.Generator) -> AirwayTree:
        deep = [b.id for b in tree.branches if b.generation >= 5 and rng.random() < 0.25]
        segments = [b.id for b in tree.branches if is_segment(b.name)]
        return without(tree, {*deep, *(int(k) for k in rng.choice(segments, 2, replace=False))})

    right, wrong = scores(prune)
    assert right >= 0.80
    assert wrong <= 0.17


@pytest.mark.slow
def test_tree_that_ends_at_the_segments_is_named_correctly():
    right, wrong = scores(
        lambda tree, _rng: without(tree, {c for b in tree.branches if is_segment(b.name) for c in b.children})
    )
    assert right >= 0.90
    assert wrong <= 0.06


@pytest.mark.slow
def test_short_false_branches_do_not_change_the_names_of_segments():
    right, wrong = scores(lambda tree, rng: with_twigs(tree, rng, 15))
    assert right >= 0.88
    assert wrong <= 0.08


def test_mirrored_chest_is_reported_and_names_state_the_true_sides():
    for seed in (1, 2, 3):
        tree = true_tree(seed)
        named = name_tree(moved(tree, np.diag([-1.0, 1.0, 1.0])))
        assert "mirrored" in (named.root.variant or "")
        (badge,) = [note for note in named.notes if note.code == "track.mirrored"]
        assert badge.badge
        assert badge.words.startswith("the airways are mirrored: the three-lobed lung is on the patient's left")
        assert name_tree(named).notes == named.notes
        lobes = branch_side_and_lobe(moved(tree, np.diag([-1.0, 1.0, 1.0])))
        for b in named.branches:
            middle = b.points[len(b.points) // 2]
            if b.name and b.name[0] in "RL" and b.name[1] == "B":
                assert (b.name[0] == "R") == (middle[0] < 0.0)
            lobe = lobes[b.id]
            if lobe is not None and abs(middle[0]) > 20.0:
                assert (lobe[0] == "R") == (middle[0] < 0.0)
        assert {"LML", "LB1", "LB7", "RB1+2"} & {b.name for b in named.branches} >= {"LML", "LB1"}


def test_part_of_a_rotated_chest_is_not_reported_as_mirrored():
    tree = moved(true_tree(5), turned((1.0, 0.0, 0.0), 30.0))
    is_outside = {b.id for b in tree.branches[1:] if b.points[:, 2].min() < -25.0 or b.points[:, 2].max() > 30.0}
    part = name_tree(without(tree, is_outside))
    assert len(part) >= 12
    assert "track.mirrored" not in {note.code for note in part.notes}


def test_ordinary_chest_is_not_reported_as_mirrored():
    for seed in SEEDS:
        named = name_tree(true_tree(seed))
        assert "mirrored" not in (named.root.variant or "")
        assert named.notes == ()


@pytest.mark.slow
def test_tree_that_begins_in_the_right_main_bronchus_is_named_correctly():
    rows = [score(true_tree(seed), name_tree(rooted_at(true_tree(seed), "RMB"))) for seed in SEEDS]
    right, wrong, total = np.sum(rows, axis=0)
    assert right >= 0.85 * total
    assert wrong <= 0.10 * total


@pytest.mark.slow
def test_tree_of_one_lung_is_named_correctly():
    for lost, side in (("LMB", "R"), ("RMB", "L")):
        rows = []
        for seed in SEEDS:
            tree = true_tree(seed)
            branch = tree.named(lost)
            named = name_tree(without(tree, {branch.id}))
            rows.append(score(tree, named))
            assert not any(b.name and b.name[1:2] == "B" and b.name[0] != side for b in named.branches)
        right, wrong, total = np.sum(rows, axis=0)
        assert right >= 0.80 * total, lost
        assert wrong <= 0.12 * total, lost


@pytest.mark.slow
def test_tree_with_a_trachea_cut_off_above_the_carina_is_named_correctly():
    def cut(tree: AirwayTree, _rng: np.random.Generator) -> AirwayTree:
        root = dataclasses.replace(tree.root, points=tree.root.points[-6:], radius=tree.root.radius[-6:])
        return AirwayTree((root, *tree.branches[1:]))

    right, wrong = scores(cut)
    assert right >= 0.92
    assert wrong <= 0.06


def test_lobe_is_correct_for_98_percent_of_the_tree_length():
    good = length = 0.0
    for seed in SEEDS:
        tree = true_tree(seed)
        found = branch_side_and_lobe(tree)
        true: dict[int, str | None] = {}
        for b in tree.branches:
            true[b.id] = LOBE_OF.get(b.name or "", None if b.name else true.get(b.parent or 0))
            good += b.length_mm * (found[b.id] == true[b.id])
            length += b.length_mm
    assert good >= 0.98 * length


def test_cached_lobes_of_a_tree_are_not_changed_by_a_caller_and_not_used_for_a_renamed_tree():
    tree = true_tree(3)
    first = branch_side_and_lobe(tree)
    first[tree.root.id] = "RUL"
    again = branch_side_and_lobe(tree)
    assert again[tree.root.id] is None
    assert again == branch_side_and_lobe(AirwayTree(tuple(dataclasses.replace(branch) for branch in tree.branches)))
    upper = next(branch for branch in tree.branches if again[branch.id] == "RUL")
    renamed = dataclasses.replace(upper, name="LB9", name_from="person")
    other = AirwayTree(tuple(renamed if branch is upper else branch for branch in tree.branches))
    assert branch_side_and_lobe(other)[upper.id] == "LLL"


def test_branch_name_given_by_the_user_is_unchanged_and_used_for_other_names():
    tree = true_tree(3)
    segment = tree.named("RB3")

    def give(name: str) -> AirwayTree:
        return name_tree(
            AirwayTree(
                tuple(
                    dataclasses.replace(
                        b, name=name if b is segment else None, name_from="person" if b is segment else None
                    )
                    for b in tree.branches
                )
            )
        )

    ours = give("RB2")
    renamed = ours.branch(segment.id)
    assert (renamed.name, renamed.name_from, renamed.name_confidence) == ("RB2", "person", None)
    # The automatic names do not contain the given RB2 again.
    assert [b.id for b in ours.branches if b.name == "RB2"] == [segment.id]
    free = give("the one with the stent")
    assert free.branch(segment.id).name == "the one with the stent"
    assert "RB2" in free.names


def test_name_given_to_a_branch_below_a_segment_determines_the_segment():
    tree = true_tree(1)
    segment = tree.named("RB10")
    child = segment.children[0]
    named = name_tree(
        AirwayTree(
            tuple(
                dataclasses.replace(
                    b, name="RB10c" if b.id == child else None, name_from="person" if b.id == child else None
                )
                for b in tree.branches
            )
        )
    )
    assert named.branch(segment.id).name == "RB10"
    assert named.branch(child).name == "RB10c"


@pytest.mark.parametrize("seed", [1, 4])
def test_fork_of_rb8_is_read_as_a_stem_with_rb7_only_if_a_user_named_rb7(seed):
    box = ((-10.0, -10.0, -10.0), (10.0, 10.0, 10.0))
    made = generate_phantom(seed=seed, spacing_mm=5.0, box_lps=box, variant="absent-rb7", progress=False)
    tree = AirwayTree.from_json(made.truth)
    stem = tree.named("RB8")
    medial = max(stem.children, key=lambda child: tree.branch(child).tip_lps[0])
    for person in (False, True):
        named = name_tree(
            AirwayTree(
                tuple(
                    dataclasses.replace(
                        b,
                        name="RB7" if person and b.id == medial else None,
                        name_from="person" if person and b.id == medial else None,
                    )
                    for b in tree.branches
                )
            )
        )
        assert named.branch(stem.id).name == ("RB7+8" if person else "RB8")
        assert ("RB7" in named.names) == person


def test_close_territories_are_one_basal_segment_and_distant_ones_are_two():
    probability = [probability_of_one_segment(apart) for apart in (0.0, 0.25, 0.35, 0.42, 0.5, 0.9)]
    assert probability == sorted(probability, reverse=True)
    assert probability[2] > 0.8
    assert probability[3] < 0.3


def test_naming_a_named_tree_again_gives_equal_names():
    tree = true_tree(5)
    once, twice = name_tree(tree), name_tree(name_tree(tree))
    assert [(b.name, b.name_confidence, b.variant) for b in once.branches] == [
        (b.name, b.name_confidence, b.variant) for b in twice.branches
    ]
    for before, after in zip(tree.branches, once.branches, strict=True):
        assert before.id == after.id
        assert before.points is after.points


def test_letters_of_subsegments_follow_the_nomenclature_rule():
    back, front = np.array([0.0, 10.0, 0.0]), np.array([0.0, -10.0, 3.0])
    assert letter_order([front, back], LetterRule.BACK_FIRST)[0] == [1, 0]
    assert letter_order([front, back], LetterRule.TOP_LATERAL_BACK)[0] == [1, 0]
    low, high = np.array([0.0, 1.0, -9.0]), np.array([0.0, 0.0, 9.0])
    order, sure = letter_order([low, high], LetterRule.TOP_LATERAL_BACK)
    assert order == [1, 0]
    assert sure > 0.95
    tree = true_tree(2)
    named = name_tree(tree)
    a, b = named.named("RB6a"), named.named("RB6b")
    assert a.parent == b.parent == named.named("RB6").id
    other = name_tree(tree, letter_rule=LetterRule.BACK_FIRST)
    for segment in ("RB1", "RB6", "LB3"):
        pair = f"{segment}a", f"{segment}b"
        if set(pair) <= set(other.names):
            assert other.named(pair[0]).points[-1][1] > other.named(pair[1]).points[-1][1] - 5.0


def test_tree_without_forks_has_no_names():
    tube = Branch(0, None, (), 0, None, "tracked", np.array([[0.0, 0, 0], [0, 1, -40]]), np.array([8.0, 8.0]))
    assert name_tree(AirwayTree((tube,))).root.name is None


def test_anatomical_variants_of_phantoms_are_named_correctly():
    for seed in SEEDS:
        tree, named = true_tree(seed), name_tree(true_tree(seed))
        variants = " ".join(b.variant or "" for b in named.branches)
        for stem, text in (("RB1+2", "RB1 and RB2 share a stem"), ("RB2+3", "RB2 and RB3 share a stem")):
            assert (stem in tree.names) == (text in variants), seed


def regrafted(tree: AirwayTree, name: str, host_name: str, share: float) -> tuple[AirwayTree, int]:
    """Return the tree with a bronchus and its descendants moved to another bronchus, and the bronchus's ID."""
    branches = {b.id: b for b in tree.branches}
    sub, host = tree.named(name), tree.named(host_name)
    mid, lower = int(len(host.points) * share), max(branches) + 1
    offset = host.points[mid] - sub.points[0]
    moved_ids = [sub.id]
    for b in tree.branches:
        if b.parent in moved_ids:
            moved_ids.append(b.id)
    for k in moved_ids:
        branches[k] = dataclasses.replace(branches[k], points=branches[k].points + offset)
    before = branches[sub.parent or 0]
    branches[before.id] = dataclasses.replace(before, children=tuple(c for c in before.children if c != sub.id))
    host = branches[host.id]
    branches[lower] = dataclasses.replace(
        host, id=lower, parent=host.id, points=host.points[mid:], radius=host.radius[mid:]
    )
    for c in host.children:
        branches[c] = dataclasses.replace(branches[c], parent=lower)
    branches[host.id] = dataclasses.replace(
        host, points=host.points[: mid + 1], radius=host.radius[: mid + 1], children=(lower, sub.id)
    )
    branches[sub.id] = dataclasses.replace(branches[sub.id], parent=host.id)
    made: list[Branch] = []
    waiting = [tree.root.id]
    while waiting:
        b = branches[waiting.pop(0)]
        if b.parent is not None:
            # The first point must equal the parent's last point to the last bit.
            b = dataclasses.replace(b, points=np.concatenate([branches[b.parent].points[-1:], b.points[1:]]))
            branches[b.id] = b
        made.append(b)
        waiting.extend(b.children)
    return AirwayTree(tuple(made)), sub.id


@pytest.mark.parametrize(
    ("name", "host", "share", "text"),
    [
        ("RUL", "Trachea", 0.9, "tracheal bronchus"),
        ("RB1", "Trachea", 0.85, "tracheal bronchus"),
        ("RB6", "BI", 0.5, "at or above the middle lobe bronchus"),
    ],
)
def test_bronchus_with_an_unusually_high_origin_is_reported_as_variant(name, host, share, text):
    changed, which = regrafted(true_tree(4), name, host, share)
    named = name_tree(changed)
    assert named.branch(which).name == name
    assert text in (named.branch(which).variant or "")
    right, wrong, total = score(true_tree(4), named)
    assert right >= total - 1
    assert wrong == 0


def test_every_branch_name_has_a_full_text():
    for keys in LOBES.values():
        for key in keys:
            full_name = name_words(key)
            assert full_name is not None
            assert full_name.side == ("right" if key.startswith("R") else "left")
    for name in grammar().names:
        assert name_words(name) is not None, name
    assert name_words("RB6").full == "RB6 (superior segment, RLL)"  # type: ignore[union-attr]
    assert name_words("lb7+8").short == "LB8"  # type: ignore[union-attr]
    assert name_words("RB10ai").boyden == "B10ai"  # type: ignore[union-attr]
    assert name_words("RB11") is None
    assert name_words("") is None


def test_expected_directions_of_bronchi_point_to_their_side():
    rules = grammar()
    for name in ("RMB", "BI", *LOBES, "LMB"):
        right_or_left = -1.0 if name == "BI" or name.startswith("R") else 1.0
        states = [number for number, of in enumerate(rules.names) if of == name]
        assert states
        assert set(rules.side[states]) == {right_or_left}
        assert (rules.direction[states, 0] * right_or_left > 0.2).all(), name


def test_probabilities_of_all_divisions_of_a_bronchus_sum_to_one():
    rules = grammar()
    division = rules.division
    for state in np.unique(division.state):
        total = np.exp(division.log_prior[division.state == state]).sum() / 2.0
        assert total == pytest.approx(1.0, abs=0.061)


def test_sums_over_all_possible_namings_of_a_tree_equal_plain_recursion():
    """Compare with an enumeration of every derivation of the grammar, on a small tree of binary forks."""
    tree = true_tree(5)
    small = without(tree, {b.id for b in tree.branches if b.generation >= 3})
    bronchi = bronchi_of(small)
    assert all(len(b.children) in {0, 2} for b in bronchi)
    rules = grammar()
    solver = Solver(rules, bronchi, find_lungs(bronchi), np.eye(3))
    division, shrink = rules.division, {state: (others, odds) for state, others, odds in rules.shrink}
    parts = {n: solver.part_of(n) for n in range(1, len(bronchi))}

    @functools.cache
    def odds_of(number: int, state: int) -> float:
        own = 0.0
        local = math.exp(solver.model.evidence(number)[state])
        if rules.terminal[state]:
            own = local
        elif not bronchi[number].children:
            own = local * math.exp(solver.ending(number)[state])
        else:
            one, two = bronchi[number].children
            apart = solver.model.apart(parts[one], parts[two])
            for row in np.flatnonzero(division.state == state):
                weight = math.exp(division.log_prior[row] + apart[row])
                own += local * weight * odds_of(one, int(division.one[row])) * odds_of(two, int(division.two[row]))
            own += local * odds_of(one, state) * math.exp(parts[two].spur)
            own += local * odds_of(two, state) * math.exp(parts[one].spur)
        if state in shrink:
            others, log_odds = shrink[state]
            own += sum(math.exp(o) * odds_of(number, int(k)) for k, o in zip(others, log_odds, strict=True))
        return own

    for state in range(len(rules)):
        slow, fast = odds_of(0, state), float(solver.sums[0][state])
        assert math.exp(fast) == pytest.approx(slow, rel=1e-9, abs=1e-300), rules.names[state]
    solver.solution()
    root = solver.posts[0]
    assert root.sum() == pytest.approx(1.0)
    for posts in solver.posts:
        # In each naming of the tree a bronchus has at most one name, and none if it leads to no segment or is inside a
        # segment.
        assert posts.min() >= 0.0
        assert posts.sum() <= 1.0 + 1e-9
