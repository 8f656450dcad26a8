"""Tests of the airway tree as a document: round trip, and refusal of invalid geometry."""

from __future__ import annotations

import copy
import dataclasses
import json

import numpy as np
import pytest

from carina.errors import TrackingError, UsageError
from carina.track import AirwayTree, Branch


@pytest.fixture
def tree() -> AirwayTree:
    trunk = np.array([[0.1, 0.2, 50.0], [0.0, 0.3, 25.0], [1.0 / 3.0, 0.0, 0.0]])
    right = np.array([trunk[-1], [-9.0, 1.0, -8.0], [-20.0, 2.0, -15.0]])
    left = np.array([trunk[-1], [21.0, -2.0, -14.0]])
    return AirwayTree(
        (
            Branch(4, None, (7, 5), 0, "Trachea", "tracked", trunk, np.array([8.0, 8.1, 7.9]), 12.5),
            Branch(7, 4, (), 1, "RMB", "tracked", right, np.array([7.0, 6.0, 5.0]), 30.0, 0.9),
            Branch(5, 4, (), 1, None, "manual", left, np.array([7.0, 5.0])),
        )
    )


def test_tree_is_restored_from_its_json_bit_for_bit(tree):
    document = json.loads(json.dumps(tree.to_json(), allow_nan=False))
    assert document["format"] == "carina-tree"
    assert document["version"] == 1
    assert (document["space"], document["unit"], document["root"]) == ("LPS", "mm", 4)
    back = AirwayTree.from_json(document)
    assert [b.id for b in back.branches] == [4, 7, 5]
    for a, b in zip(tree.branches, back.branches, strict=True):
        assert (a.parent, a.children, a.generation, a.name, a.kind) == (
            b.parent,
            b.children,
            b.generation,
            b.name,
            b.kind,
        )
        assert (a.cost, a.confidence) == (b.cost, b.confidence)
        assert a.points.tobytes() == b.points.tobytes()
        assert a.radius.tobytes() == b.radius.tobytes()


def cut_in_two(**lower: object) -> AirwayTree:
    """Return a tree in which RB6 continues beyond a side branch; ``lower`` changes the part beyond it."""

    def piece(number, parent, children, name, radius_mm):
        start_mm = {0: 0.0, 1: 10.0, 2: 20.0, 3: 20.0, 4: 30.0}[number]
        points = np.array([[0.0, 0.0, -start_mm], [0.0, 0.0, -start_mm - 10.0]])
        radius = np.full(2, radius_mm)
        return Branch(number, parent, children, number, name, "tracked", points, radius, name_from=name and "anatomy")

    second = dataclasses.replace(piece(2, 1, (4,), "RB6", 1.5), **lower)
    return AirwayTree(
        (
            piece(0, None, (1,), "RLL", 4.0),
            piece(1, 0, (2, 3), "RB6", 2.0),
            second,
            piece(3, 1, (), None, 1.0),
            piece(4, 2, (), "RB6a", 1.0),
        )
    )


def test_bronchus_divided_by_a_side_branch_is_one_row_of_the_branch_list():
    tree = cut_in_two()
    rows = tree.rows()
    assert [(row.name, [b.id for b in row.branches], row.depth) for row in rows] == [
        ("RLL", [0], 0),
        ("RB6", [1, 2], 1),
        (None, [3], 2),
        ("RB6a", [4], 2),
    ]
    assert (rows[1].length_mm, rows[1].lumen_mm, rows[1].calibre) == (20.0, (3.0, 4.0), "3.0 to 4.0")
    page = tree.to_html()
    assert page.count(">RB6<") == 1
    assert "3.0 to 4.0" in page
    assert len(tree.to_json()["branches"]) == 5


@pytest.mark.parametrize("lower", [{"name_from": "person"}, {"kind": "bridge"}, {"name": "RB7"}])
def test_branches_named_or_drawn_by_the_user_have_separate_rows_in_the_branch_list(lower):
    assert [[b.id for b in row.branches] for row in cut_in_two(**lower).rows()][1:3] == [[1], [2]]


def test_tree_json_with_unknown_keys_and_another_branch_order_gives_the_same_tree(tree):
    document = tree.to_json() | {"maker": "another tool"}
    document["branches"][1]["colour"] = "red"
    document["branches"].reverse()
    assert [b.id for b in AirwayTree.from_json(document).branches] == [4, 7, 5]


def breakages():
    def change(path, value):
        def apply(document):
            place = document
            for key in path[:-1]:
                place = place[key]
            place[path[-1]] = value

        return apply

    yield "format", change(["format"], "other"), "format"
    yield "newer version", change(["version"], 2), "version"
    yield "RAS", change(["space"], "RAS"), "space"
    yield "metres", change(["unit"], "m"), "unit"
    yield "no branches", change(["branches"], []), "at least one"
    yield "root missing", change(["root"], 99), "root"
    yield "root as text", change(["root"], "4"), "root"
    yield "NaN", change(["branches", 1, "points", 1], [float("nan"), 0, 0]), "finite"
    yield "two coordinates", change(["branches", 1, "points"], [[0.0, 1.0]]), "points"
    yield "ragged points", change(["branches", 1, "points"], [[0.0, 1.0, 2.0], [3.0]]), "points"
    yield "no points", change(["branches", 1, "points"], []), "points"
    yield "short radius", change(["branches", 1, "radius"], [1.0]), "radius"
    yield "negative radius", change(["branches", 1, "radius", 0], -1.0), "radius"
    yield "loose start", change(["branches", 1, "points", 0, 0], 5.0), "first point"
    yield "unknown parent", change(["branches", 1, "parent"], 77), "parent"
    yield "unlisted child", change(["branches", 0, "children"], [7]), "not connected"
    yield "missing child", change(["branches", 0, "children"], [7, 5, 8]), "child"
    yield "own ancestor", change(["branches", 1, "children"], [4]), "child"
    yield "doubled id", change(["branches", 1, "id"], 5), "same id"
    yield "kind", change(["branches", 1, "kind"], "guessed"), "kind"
    yield "confidence", change(["branches", 1, "confidence"], 1.5), "confidence"
    yield "generation", change(["branches", 1, "generation"], "one"), "generation"
    yield "name", change(["branches", 1, "name"], 3), "name"
    yield "cost", change(["branches", 1, "cost"], "dear"), "cost"
    yield "branch is a list", change(["branches", 1], []), "object"


@pytest.mark.parametrize(("damage", "word"), [pytest.param(d, w, id=name) for name, d, w in breakages()])
def test_invalid_tree_json_is_refused_with_its_reason(tree, damage, word):
    document = copy.deepcopy(tree.to_json())
    damage(document)
    with pytest.raises(TrackingError, match=word) as caught:
        AirwayTree.from_json(document)
    assert caught.value.code == "track.tree-format"


@pytest.mark.parametrize("document", [None, [], "tree", 3])
def test_json_of_another_kind_than_a_tree_is_refused(document):
    with pytest.raises(TrackingError, match="object"):
        AirwayTree.from_json(document)


def test_tips_lineage_nearest_branch_and_route_of_a_known_tree_are_the_expected_ones(tree):
    assert [b.id for b in tree.tips()] == [7, 5]
    assert [b.id for b in tree.lineage(5)] == [4, 5]
    branch, index, distance = tree.nearest_branch([-9.0, 1.0, -7.0])
    assert (branch.id, index, distance) == (7, 1, 1.0)
    route = tree.route_to(7)
    assert route.points_lps.shape == (5, 3)
    assert list(route.generation) == [0, 0, 0, 1, 1]
    assert route.forks_mm == [pytest.approx(tree.root.length_mm)]
    assert route.length_mm == pytest.approx(tree.root.length_mm + tree.branch(7).length_mm)
    with pytest.raises(UsageError, match="no branch"):
        tree.route_to(1)


def test_branch_is_found_by_its_name_and_an_unknown_name_is_refused_with_all_names(tree):
    assert tree.names == ("Trachea", "RMB")
    assert tree.named("RMB") is tree.branches[1]
    with pytest.raises(UsageError, match=r"^no branch is named 'RB99'; the names in this tree are Trachea, RMB$"):
        tree.named("RB99")
    nameless = AirwayTree(tuple(dataclasses.replace(one, name=None, name_from=None) for one in tree.branches))
    assert nameless.names == ()
    with pytest.raises(UsageError, match=r"^no branch is named 'RMB'; no branch has a name$"):
        nameless.named("RMB")


def test_name_shared_by_two_branches_is_listed_once_and_returns_the_first():
    tree = cut_in_two()
    assert tree.names.count("RB6") == 1
    assert tree.named("RB6") is next(one for one in tree.branches if one.name == "RB6")
