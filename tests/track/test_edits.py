"""Tests of edits of the airway tree, on a small drawn tree: each edit changes what it names and nothing else."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from edit_case import assert_same, edit_case
from edit_sequences import KINDS, Editing, run_sequence
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, rule

from carina.errors import CancelledError, NoEvidenceError, NoResultError, UsageError
from carina.track import (
    AddBranch,
    AirwayTree,
    Bridge,
    CutBranch,
    MoveFork,
    MoveRoot,
    PaintLumen,
    RenameBranch,
    SmoothBranch,
    edit_airways,
    edits_from_json,
    edits_to_json,
    rebuild_airways,
)
from carina.track.edit.tree_changes import TreeDraft
from carina.track.find.airway_ends import find_uncertain
from carina.track.tree.airway_tree import Branch


@pytest.fixture
def case():
    return edit_case()


def edited(case, *edits, start=None):
    airways = start or case.airways
    for edit in edits:
        airways = edit_airways(case.volume, airways, edit)
    return airways


def point(values):
    return tuple(float(v) for v in values)


def branch_to(airways, lps):
    branch, _, away_mm = airways.tree.nearest_branch(lps)
    assert away_mm < 3.0
    return branch


def off_line(points, a, b):
    along = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
    return np.linalg.norm(points - a - along[:, None] * (b - a), axis=1)


def snapshot(airways):
    return [(b.id, b.parent, b.children, b.points.copy(), b.radius.copy()) for b in airways.tree.branches]


# ------------------------------------------------------------ cut and add


def test_cut_removes_the_selected_branch_with_its_lumen_and_no_other(case):
    removed = branch_to(case.airways, case.tips[0])
    airways = edited(case, CutBranch(removed.id))
    # The sibling and the parent become one branch with the parent's ID.
    parent = airways.tree.branch(removed.parent)
    assert not parent.children
    assert {b.id for b in airways.tree.branches} == {0, 1, 4, 5, 6} - {
        removed.id,
        *case.airways.tree.branch(1).children,
    } | {1}
    for branch in airways.tree.branches:
        if branch.id in {0, 4, 5, 6}:
            np.testing.assert_array_equal(branch.points, case.airways.tree.branch(branch.id).points)
    middle = removed.points[len(removed.points) // 2 :]
    assert not airways.tracker.inside(middle).any()
    others = np.concatenate([b.points for b in airways.tree.branches])
    assert airways.tracker.inside(others).all()
    assert airways.lumen_zyx.sum() < case.airways.lumen_zyx.sum()
    # No path leads to the removed branch any more.
    with pytest.raises(NoResultError, match="from the segmented lumen"):
        airways.tracker.path_to(removed.tip_lps, snap_mm=1.0)


def test_branch_cut_at_a_point_ends_at_that_point_and_retains_its_id(case):
    whole = branch_to(case.airways, case.tips[0])
    airways = edited(case, CutBranch(whole.id, 5.0))
    short = airways.tree.branch(whole.id)
    assert 3.0 < short.length_mm <= 5.0
    np.testing.assert_array_equal(short.points, whole.points[: len(short.points)])
    assert not airways.tracker.inside(whole.points[-3:]).any()


def test_click_on_the_end_of_a_cut_branch_adds_it_again_with_confidence(case):
    removed = branch_to(case.airways, case.tips[0])
    airways = edited(case, CutBranch(removed.id), AddBranch(point(case.tips[0])))
    new = branch_to(airways, case.tips[0])
    assert new.kind == "tracked"
    assert new.doubtful_mm == 0.0
    assert new.confidence is not None
    assert new.confidence > 0.5
    assert new.id >= 7  # The ID was never used before.
    assert airways.tree.branch(new.parent).points[-1] == pytest.approx(removed.points[0], abs=6.0)
    np.testing.assert_allclose(new.tip_lps, case.tips[0], atol=0.8)  # The tolerance is half of a voxel's diagonal.
    off = off_line(new.points[3:], removed.points[0], case.tips[0])
    assert off.max() < 1.5  # The tolerance is one voxel: the path leads through the middle of the tube.
    assert 0.6 < np.median(new.radius) < 2.5  # The tube was drawn with a radius of 1.9 mm on voxels of 1 to 1.5 mm.
    assert airways.tree.branch(new.parent).id == removed.parent


def test_branch_added_inside_the_lumen_splits_its_parent(case):
    # A pocket painted beside a bronchus is lumen without a branch.
    tip = branch_to(case.airways, case.tips[3])
    shortened = edited(case, CutBranch(tip.id, 4.0))
    bridge = case.airways.tree.branch(tip.id)
    painted = edited(case, PaintLumen(tuple(point(p) for p in bridge.points[3:]), 1.5, "ball"), start=shortened)
    assert painted.tree.branch(tip.id).length_mm > shortened.tree.branch(tip.id).length_mm or any(
        b.kind == "manual" for b in painted.tree.branches
    )
    with pytest.raises(NoResultError, match="the tree already reaches this point"):
        edited(case, AddBranch(point(painted.tree.branches[0].points[3])), start=painted)


def test_added_branch_in_tissue_or_outside_the_scan_is_refused_with_a_remedy(case):
    with pytest.raises(NoResultError, match=r"this point is in tissue .* not in an airway; click in the dark middle"):
        edited(case, AddBranch(point(case.plug)))
    with pytest.raises(UsageError, match=r"the point .* lies outside the scan, which lies within x"):
        edited(case, AddBranch((900.0, 0.0, 0.0)))
    with pytest.raises(
        NoEvidenceError, match=r"the CT shows no continuous airway wall .* if the airway is obstructed, bridge"
    ):
        edited(case, AddBranch(point(case.hidden)))
    with pytest.raises(NoResultError, match="the tree already reaches this point"):
        edited(case, AddBranch(point(case.airways.tree.root.points[5])))


def test_invalid_cuts_are_refused_with_a_reason(case):
    with pytest.raises(UsageError, match="branch 99 is not in the tree"):
        edited(case, CutBranch(99))
    with pytest.raises(UsageError, match="contains the start of the tree"):
        edited(case, CutBranch(case.airways.tree.root.id))
    with pytest.raises(UsageError, match=r"is only \d+\.\d mm long"):
        edited(case, CutBranch(2, 500.0))


# ------------------------------------------------------------ bridges


def test_bridge_edit_adds_a_branch_of_kind_bridge_and_the_lumen_beyond_becomes_its_child(case):
    airways = edited(case, Bridge(point(case.hidden)))
    bridges = [b for b in airways.tree.branches if b.kind == "bridge"]
    assert len(bridges) == 1
    bridge = bridges[0]
    # The bridge leads through the plug, not around it.
    assert np.linalg.norm(bridge.points - case.plug, axis=1).min() < 1.5
    beyond = branch_to(airways, case.hidden)
    assert beyond.kind == "tracked"
    assert airways.tree.lineage(beyond.id)[-2].kind == "bridge"
    # The trachea forks at the start of the bridge; the airway beyond the blockage has the same generation as the
    # bridge.
    assert (bridge.generation, beyond.generation) == (1, 1)
    path = airways.tracker.path_to(case.hidden)
    assert {bridge.id, beyond.id} <= set(path.branch_ids.tolist())
    assert airways.tracker.inside(path.points_lps).all()
    read = AirwayTree.from_json(airways.tree.to_json())
    assert read.branch(bridge.id).kind == "bridge"
    # The bridge is still a bridge after a branch beyond it was cut and added again.
    later = edited(case, SmoothBranch(bridge.id), RenameBranch(bridge.id, "blocked"), start=airways)
    assert later.tree.branch(bridge.id).kind == "bridge"


def test_cutting_a_bridge_removes_its_descendants_and_the_bridge_can_be_added_again(case):
    airways = edited(case, Bridge(point(case.hidden)))
    bridge = next(b for b in airways.tree.branches if b.kind == "bridge")
    cut = edited(case, CutBranch(bridge.id), start=airways)
    assert all(b.kind == "tracked" for b in cut.tree.branches)
    assert not cut.tracker.inside(case.hidden[None]).any()
    again = edited(case, Bridge(point(case.hidden)), start=cut)
    assert [b.kind for b in again.tree.branches].count("bridge") == 1
    assert next(b.id for b in again.tree.branches if b.kind == "bridge") > bridge.id


def test_erased_bridge_that_is_painted_again_has_the_kind_bridge(case):
    airways = edited(case, Bridge(point(case.hidden)))
    bridge = next(b for b in airways.tree.branches if b.kind == "bridge")
    stroke = tuple(point(p) for p in bridge.points[2:-2])
    erased = edited(case, PaintLumen(stroke, 2.5, "ball", erase=True), start=airways)
    assert not erased.tracker.inside(case.plug[None]).any()
    back = edited(case, PaintLumen(stroke, 1.5, "ball"), start=erased)
    through = branch_to(back, case.plug)
    assert through.kind == "bridge"
    # The branch beyond the bridge is an airway as before.
    assert branch_to(back, case.hidden).kind != "bridge"
    assert edited(case, CutBranch(through.id), start=back).bridges == ()


def test_list_of_uncertain_airway_ends_is_updated_after_an_edit(case):
    whole = case.airways
    judged = dataclasses.replace(whole, uncertain=find_uncertain(case.volume, whole.tree, np.zeros((0, 3))))
    assert judged.uncertain
    tip = next(b for b in judged.tree.tips() if b.parent is not None)
    cut = edited(case, CutBranch(tip.id), start=judged)
    assert all(one.branch_id is None or cut.tree.branch(one.branch_id) for one in cut.uncertain)
    assert cut.uncertain == find_uncertain(case.volume, cut.tree, np.zeros((0, 3)))
    rebuilt = rebuild_airways(case.volume, judged, cut.edits)
    assert rebuilt.uncertain == cut.uncertain
    # A mask from external software has no uncertain places, and an edit adds none.
    assert edited(case, CutBranch(tip.id), start=dataclasses.replace(whole, uncertain=())).uncertain == ()


def test_impossible_bridges_are_refused_with_a_reason(case):
    with pytest.raises(NoResultError, match=r"this point is not in air .*click in the dark middle"):
        edited(case, Bridge(point(case.plug)))
    with pytest.raises(NoResultError, match="there is nothing to bridge"):
        edited(case, Bridge(point(case.airways.tree.root.points[4])))


def test_too_long_bridge_is_refused_with_its_length(case, monkeypatch):
    monkeypatch.setattr("carina.track.edit.lumen.MAX_BRIDGE_MM", 2.0)
    with pytest.raises(
        NoResultError, match=r"the bridge would be (more than )?\d+ mm long, but at most 2 mm is possible"
    ):
        edited(case, Bridge(point(case.hidden)))


# ------------------------------------------------------------ edits of the root and of forks


def test_root_moved_down_the_trachea_shortens_the_trunk(case):
    trunk = case.airways.tree.root
    airways = edited(case, MoveRoot(point(trunk.points[5])))
    np.testing.assert_array_equal(airways.tree.root.points, trunk.points[5:])
    assert [b.id for b in airways.tree.branches] == [b.id for b in case.airways.tree.branches]
    assert np.linalg.norm(airways.root_lps - trunk.points[5]) < 1e-9
    back = edited(case, MoveRoot(point(trunk.points[0])), start=airways)
    assert back.tree.root.length_mm == pytest.approx(trunk.length_mm, abs=1.5)


def test_moving_the_root_to_a_tip_reverses_the_branches_on_the_path_to_it(case):
    tip = branch_to(case.airways, case.tips[0])
    airways = edited(case, MoveRoot(point(tip.tip_lps)))
    tree = airways.tree
    assert tree.root.id == tip.id
    assert tree.root.generation == 0
    np.testing.assert_array_equal(tree.root.points, tip.points[::-1])
    up = tree.branch(tip.parent)
    assert up.parent == tip.id
    assert tree.branch(0).children == ()
    assert {b.id for b in tree.branches} == {b.id for b in case.airways.tree.branches}
    assert max(b.generation for b in tree.branches) == 3
    for branch in tree.branches:
        assert airways.tracker.inside(branch.points).all()


def test_moving_the_root_into_a_branch_gives_a_trunk_of_one_point(case):
    branch = case.airways.tree.branch(1)
    airways = edited(case, MoveRoot(point(branch.points[len(branch.points) // 2])))
    root = airways.tree.root
    assert len(root.points) == 1
    assert len(root.children) == 2
    assert sum(b.length_mm for b in airways.tree.branches) == pytest.approx(
        sum(b.length_mm for b in case.airways.tree.branches), abs=1e-6
    )


def test_moving_the_root_into_tissue_is_refused(case):
    with pytest.raises(NoResultError, match="click inside an airway"):
        edited(case, MoveRoot(point(case.plug + np.array([8.0, 6.0, 0.0]))))


def test_moving_a_fork_moves_the_branch_ends_at_it_within_the_lumen(case):
    branch = case.airways.tree.branch(1)
    wanted = branch.points[-1] + np.array([0.0, 0.0, 1.2])
    airways = edited(case, MoveFork(1, point(wanted)))
    moved = airways.tree.branch(1)
    np.testing.assert_allclose(moved.points[-1], wanted, atol=1e-9)
    np.testing.assert_array_equal(moved.points[0], branch.points[0])
    for child in moved.children:
        new, old = airways.tree.branch(child), case.airways.tree.branch(child)
        np.testing.assert_array_equal(new.points[0], moved.points[-1])
        np.testing.assert_array_equal(new.points[-1], old.points[-1])
        assert airways.tracker.inside(new.points).all()
    assert airways.lumen_zyx is case.airways.lumen_zyx


def test_moving_a_tip_as_a_fork_or_a_fork_too_far_is_refused_with_a_reason(case):
    with pytest.raises(UsageError, match="ends without a fork"):
        edited(case, MoveFork(2, point(case.tips[0])))
    with pytest.raises(UsageError, match=r"the fork would move .* mm long; move the fork a shorter distance"):
        edited(case, MoveFork(1, point(case.airways.tree.root.points[0])))


# ------------------------------------------------------------ painting and erasing the lumen


@pytest.mark.parametrize(("plane", "axis"), [("axial", 2), ("coronal", 1), ("sagittal", 0)])
def test_disc_brush_is_one_voxel_thick_in_its_plane(case, plane, axis):
    from carina.track.edit.lumen import painted_voxels

    centre = case.volume.to_lps(np.array([16.0, 12.0, 16.0]))
    voxels = painted_voxels(case.volume, PaintLumen((point(centre),), 5.0, plane)).astype(np.float64)
    off = case.volume.to_lps(voxels) - centre
    beside = np.delete(off, axis, axis=1)
    assert np.linalg.norm(beside, axis=1).max() <= 5.0
    # On a grid rotated by a few degrees the disc passes through several layers, with one voxel in each column.
    columns = {tuple(np.delete(v, axis).astype(int)) for v in voxels}
    assert len(columns) == len(voxels)
    area_mm2 = len(voxels) * np.prod(np.delete(np.array(case.volume.spacing_mm), axis))
    assert area_mm2 == pytest.approx(np.pi * 25.0, rel=0.12)


def test_lumen_painted_beyond_a_tip_extends_the_tree_until_it_is_erased(case):
    tip = branch_to(case.airways, case.tips[1])
    stroke = (point(tip.points[-1]), point(tip.points[-1] + np.array([2.0, 5.0, -1.0])))
    painted = edited(case, PaintLumen(stroke, 1.5, "ball"))
    assert painted.lumen_zyx.sum() > case.airways.lumen_zyx.sum()
    new = branch_to(painted, stroke[1])
    assert new.kind == "manual"
    assert painted.tracker.path_to(stroke[1]).length_mm > 0.0
    np.testing.assert_array_equal(painted.tree.branch(4).points, case.airways.tree.branch(4).points)
    erased = edited(case, PaintLumen(stroke, 1.5, "ball", erase=True), start=painted)
    assert not erased.tracker.inside(np.array([stroke[1]])).any()
    for branch in erased.tree.branches:
        assert erased.tracker.inside(branch.points).all()


def test_erasing_the_lumen_across_a_bronchus_cuts_the_branches_beyond_and_reports_it(case):
    branch = case.airways.tree.branch(4)
    middle = branch.points[len(branch.points) // 2]
    airways = edited(case, PaintLumen((point(middle),), 4.0, "ball", erase=True))
    assert airways.tracker.num_settled < airways.tracker.num_nodes
    assert {5, 6}.isdisjoint(b.id for b in airways.tree.branches)
    np.testing.assert_array_equal(airways.tree.branch(2).points, case.airways.tree.branch(2).points)
    # The lumen beyond the gap has no branch; painting the gap brings the branches back with new IDs.
    back = edited(case, PaintLumen((point(middle),), 4.0, "ball"), start=airways)
    assert len(back.tree.tips()) == len(case.airways.tree.tips())
    assert {b.kind for b in back.tree.branches} == {"tracked"}, "the search had found all of it"


def test_branch_through_a_painted_gap_is_of_kind_manual_and_beyond_the_gap_tracked(case):
    branch = case.airways.tree.branch(4)
    middle, aside = branch.points[len(branch.points) // 2], np.array([4.5, 0.0, 0.0])
    # The brush covers the surroundings of the erased stretch, where the search found no lumen.
    erased = edited(case, PaintLumen((point(middle),), 4.0, "ball", erase=True))
    before, after = branch.points[len(branch.points) // 2 - 5], branch.points[len(branch.points) // 2 + 5]
    way = tuple(point(p) for p in (before, before + aside, after + aside, after))
    back = edited(case, PaintLumen(way, 1.2, "ball"), start=erased)
    beyond = branch_to(back, case.tips[2])
    assert beyond.kind == "tracked"
    assert any(b.kind == "manual" for b in back.tree.lineage(beyond.id))


def test_painting_a_wider_lumen_increases_the_radius_only_at_the_paint(case):
    trunk = case.airways.tree.root
    airways = edited(case, PaintLumen((point(trunk.points[5]),), 4.5, "ball"))
    wider = airways.tree.root.radius[5]
    assert wider > trunk.radius[5] + 0.5
    np.testing.assert_array_equal(airways.tree.branch(5).radius, case.airways.tree.branch(5).radius)
    core = airways.tracker.core
    for branch in airways.tree.branches:
        np.testing.assert_array_equal(branch.wall_distance, core.radius_mm(branch.points))
    branches = airways.tree.branches
    place_of = {branch.id: place for place, branch in enumerate(branches)}
    parents = [None if branch.parent is None else place_of[branch.parent] for branch in branches]
    fresh = core.section_radii([branch.points for branch in branches], parents, [True] * len(branches))
    for branch, radius in zip(branches, fresh, strict=True):
        np.testing.assert_array_equal(branch.radius, radius)


def test_brush_strokes_without_effect_are_refused_with_a_reason(case):
    inside = point(case.airways.tree.root.points[4])
    with pytest.raises(NoResultError, match="nothing to paint: everything under the brush is already lumen"):
        edited(case, PaintLumen((inside,), 0.0))
    with pytest.raises(NoResultError, match="no lumen under the brush to erase"):
        edited(case, PaintLumen((point(case.plug),), 0.5, erase=True))
    with pytest.raises(UsageError, match="the start of the tree lies under the brush"):
        edited(case, PaintLumen((point(case.airways.root_lps),), 2.0, "ball", erase=True))
    with pytest.raises(UsageError, match="the brush stroke lies outside the scan"):
        edited(case, PaintLumen(((0.0, 0.0, 4000.0),), 2.0))


# ------------------------------------------------------------ names, smoothing, and lists of edits


def test_branch_name_given_by_the_user_is_preserved_by_edits_until_it_is_reset(case):
    airways = edited(case, RenameBranch(5, "LB6"), CutBranch(2), MoveFork(0, point(case.airways.tree.root.points[-1])))
    named = airways.tree.branch(5)
    assert (named.name, named.name_from, named.name_confidence) == ("LB6", "person", None)
    assert edited(case, RenameBranch(5, None), start=airways).tree.branch(5).name_from != "person"


def test_smoothing_a_branch_preserves_its_ends_and_reduces_its_angles(case):
    def turn(points):
        steps = np.diff(points, axis=0)
        steps /= np.linalg.norm(steps, axis=1)[:, None]
        return np.arccos(np.clip((steps[1:] * steps[:-1]).sum(axis=1), -1.0, 1.0)).sum()

    rough = case.airways.tree.branch(1)
    smooth = edited(case, SmoothBranch(1)).tree.branch(1)
    np.testing.assert_array_equal(smooth.points[[0, -1]], rough.points[[0, -1]])
    assert turn(smooth.points) < turn(rough.points)


def test_edit_returns_new_airways_and_leaves_the_given_airways_unchanged(case):
    before, lumen = snapshot(case.airways), case.airways.lumen_zyx.copy()
    edited(
        case,
        Bridge(point(case.hidden)),
        PaintLumen((point(case.tips[1]),), 3.0, "ball", erase=True),
        MoveRoot(point(case.tips[2])),
        CutBranch(0, 3.0),
    )
    np.testing.assert_array_equal(case.airways.lumen_zyx, lumen)
    for old, new in zip(before, snapshot(case.airways), strict=True):
        assert old[:3] == new[:3]
        np.testing.assert_array_equal(old[3], new[3])
        np.testing.assert_array_equal(old[4], new[4])


def test_list_of_edits_restored_from_json_gives_equal_airways(case):
    airways = edited(case, Bridge(point(case.hidden)), CutBranch(2), RenameBranch(4, "LMB"), SmoothBranch(5))
    saved = edits_from_json(edits_to_json(airways.edits))
    assert_same(rebuild_airways(case.volume, case.airways, saved), airways)


def test_refused_edit_in_a_list_is_reported_with_its_number(case):
    edits = (SmoothBranch(5), CutBranch(999), CutBranch(2))
    with pytest.raises(UsageError, match=r"^edit 2 of 3: ") as refused:
        rebuild_airways(case.volume, case.airways, edits)
    with pytest.raises(UsageError) as alone:
        edit_airways(case.volume, case.airways, edits[1])
    assert str(refused.value) == f"edit 2 of 3: {alone.value}"
    assert refused.value.code == alone.value.code


def test_edit_of_the_tree_can_be_cancelled(case):
    with pytest.raises(CancelledError):
        edit_airways(case.volume, case.airways, CutBranch(2), cancel=lambda: True)
    reported = []
    edit_airways(case.volume, case.airways, CutBranch(2), progress=lambda what, share: reported.append((what, share)))
    assert reported


def test_airways_from_the_mask_of_another_tool_can_be_edited(case):
    from carina.track import find_airways

    masked = find_airways(case.volume, root_lps=case.airways.root_lps, lumen_zyx=case.airways.lumen_zyx)
    airways = edited(case, CutBranch(masked.tree.tips()[0].id), Bridge(point(case.hidden)), start=masked)
    assert [b.kind for b in airways.tree.branches].count("bridge") == 1
    assert_same(airways, rebuild_airways(case.volume, masked, airways.edits))


def test_branch_added_in_another_tools_mask_joins_the_tree_at_the_same_place(case):
    from carina.track import find_airways

    joins = []
    for airways in (
        case.airways,
        find_airways(case.volume, root_lps=case.airways.root_lps, lumen_zyx=case.airways.lumen_zyx),
    ):
        leaf = airways.tree.nearest_branch(case.tips[3])[0]
        cut = edited(case, CutBranch(leaf.id, 0.4 * leaf.length_mm), start=airways)
        stump = cut.tree.branch(leaf.id)
        new = edited(case, AddBranch(point(leaf.points[-1])), start=cut)
        grown = new.tree.branch(leaf.id)
        assert len(new.tree) == len(cut.tree), "the tip is extended, and no branch is added"
        assert abs(grown.length_mm - leaf.length_mm) < 2.0
        np.testing.assert_allclose(grown.points[: len(stump.points) - 1], stump.points[:-1], atol=1.5)
        joins.append(grown.points[-1])
    np.testing.assert_allclose(joins[0], joins[1], atol=1.0)


class EditSequences(RuleBasedStateMachine):
    """Random edits, undo and redo; after each step the tree equals the tree built from scratch."""

    def __init__(self) -> None:
        super().__init__()
        self.editing = Editing()

    @rule(kind=st.sampled_from(KINDS), numbers=st.lists(st.integers(0, 10_000), min_size=8, max_size=8))
    def edit(self, kind: str, numbers: list[int]) -> None:
        drawn = iter(numbers)
        self.editing.edit(kind, lambda n: next(drawn) % n)

    @rule()
    def undo(self) -> None:
        self.editing.undo()

    @rule()
    def redo(self) -> None:
        self.editing.redo()

    def teardown(self) -> None:
        self.editing.check(self.editing.airways)


TestEditSequences = EditSequences.TestCase
TestEditSequences.settings = settings(max_examples=80, stateful_step_count=8, deadline=None, derandomize=True)


@pytest.mark.soak
def test_airways_after_ten_thousand_random_edit_sequences_equal_trees_built_from_scratch(monkeypatch):
    # Naming depends on the tree alone and would take half of the time.
    monkeypatch.setattr("carina.track.edit.edits.name_edited_tree", lambda _before, tree: tree)
    for seed in range(10_000):
        editing = run_sequence(seed)
        editing.check(editing.airways)


def test_comparison_helper_fails_for_airways_that_differ_in_one_radius(case):
    airways = edited(case, CutBranch(2))
    first = airways.tree.branches[0]
    shifted = dataclasses.replace(first, radius=np.nextafter(first.radius, np.inf))
    other = dataclasses.replace(airways.tree, branches=(shifted, *airways.tree.branches[1:]))
    with pytest.raises(AssertionError, match="radius of branch 0"):
        assert_same(dataclasses.replace(airways, tree=other), airways)


def test_shortening_a_drawn_branch_shortens_its_doubtful_length_in_proportion():
    points = np.linspace([0.0, 0.0, 0.0], [0.0, 0.0, -0.8], 9)
    drawn = Branch(0, None, (), 0, None, "manual", points, np.full(9, 0.5), doubtful_mm=0.6)
    tree = TreeDraft(AirwayTree((drawn,)), next_id=1)
    tree.shorten(0, 4)
    assert tree[0].doubtful_mm == pytest.approx(0.3)
