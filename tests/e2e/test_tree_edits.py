"""Tests of manual edits of the tree in the browser: brush, smoothing, forks, root, bridge, and undo of each."""

from __future__ import annotations

import pytest
from page_positions import (
    PREVIEWED,
    all_points,
    named,
    place_in_slice,
    place_in_tri_plane,
    place_on_tree,
    show_slices_at,
    tree_is_shown,
)

pytestmark = pytest.mark.browser


@pytest.fixture
def ready(server, workstation):
    """Return a page with the case open and its tree shown."""
    workstation.open(server)
    workstation.wait_ready()
    tree_is_shown(workstation)
    yield workstation
    assert workstation.faults == []


def tree_text(workstation):
    """Return the whole tree as text, to detect changes."""
    return workstation.page.evaluate(TREE_TEXT)


TREE_TEXT = "() => JSON.stringify([...window.__carina.state.tree.byId.values()].map((node) => node.branch))"


def wait_for_edit(workstation, text, before):
    """Wait until the edit is listed under Undo and complete, and the tree differs from ``before``."""
    workstation.wait_for("(words) => (window.__carina.state.can_undo ?? '').startsWith(words)", text)
    workstation.wait_for("() => !window.__carina.state.jobs.some((job) => job.job_id.startsWith('edit'))")
    workstation.wait_for(f"(before) => ({TREE_TEXT})() !== before", before)


def undo_to(workstation, before):
    """Press Ctrl+Z until the tree equals ``before``."""
    workstation.page.keyboard.press("Escape")
    workstation.page.keyboard.press("Control+z")
    workstation.wait_for(f"(before) => ({TREE_TEXT})() === before", before)


def points_of(workstation, branch_id):
    return workstation.page.evaluate("(id) => window.__carina.state.tree.byId.get(id).branch.points", branch_id)


def test_lumen_erased_with_the_brush_removes_branches_and_painting_restores_them(ready):
    before, num_before = tree_text(ready), ready.state("tree.byId.size")
    lmb = named(ready, "LMB")
    points = points_of(ready, lmb)
    middle = points[len(points) // 2]
    show_slices_at(ready, middle)
    ready.page.keyboard.press("Shift+Q")
    for _ in range(8):
        ready.page.keyboard.press("]")
    # The brush is a ball, because a gap in one slice alone would leave a path around it.
    ready.page.locator("[data-testid=in-hand]").get_by_text("3D", exact=True).click()
    ready.page.evaluate("() => document.activeElement.blur()")
    x, y = place_in_slice(ready, "coronal", middle)
    ready.page.mouse.move(x, y)
    ready.picture("before-erasing")
    ready.page.mouse.down()
    ready.page.mouse.move(x + 3, y + 3, steps=3)
    ready.page.mouse.up()
    wait_for_edit(ready, "erase", before)
    erased = tree_text(ready)
    assert len(erased) < 0.8 * len(before), "the branches beyond the bronchus are removed"
    ready.picture("after-erasing")

    # Painting over the gap is a second edit, not an undo.
    ready.page.keyboard.press("Escape")
    ready.page.keyboard.press("q")
    ready.page.mouse.move(x, y)
    ready.page.mouse.down()
    ready.page.mouse.move(x + 3, y + 3, steps=3)
    ready.page.mouse.up()
    wait_for_edit(ready, "paint", erased)
    # The branches beyond the bronchus are restored.
    ready.wait_for("(num) => window.__carina.state.tree.byId.size >= num", num_before)
    ready.picture("after-painting")
    ready.page.keyboard.press("Escape")
    ready.page.keyboard.press("Control+z")
    ready.wait_for("() => (window.__carina.state.can_undo ?? '').startsWith('erase')")
    undo_to(ready, before)


def test_smoothed_branch_has_a_changed_centreline_until_undo(ready):
    before = tree_text(ready)
    lmb = named(ready, "LMB")
    was = points_of(ready, lmb)
    ready.page.keyboard.press("u")
    x, y = place_on_tree(ready, lmb)
    ready.page.mouse.move(x, y)
    ready.wait_for("(id) => window.__carina.state.ui.hovered?.branchId === id", lmb)
    ready.page.mouse.click(x, y)
    wait_for_edit(ready, "smooth", before)
    assert points_of(ready, lmb) != was
    undo_to(ready, before)
    assert points_of(ready, lmb) == was


def test_fork_is_moved_by_two_clicks_and_restored_by_undo(ready):
    before = tree_text(ready)
    lmb = named(ready, "LMB")
    points = points_of(ready, lmb)
    ready.page.keyboard.press("y")
    x, y = place_on_tree(ready, lmb, 0.95)
    ready.page.mouse.move(x, y)
    ready.wait_for("(id) => window.__carina.state.ui.hovered?.branchId === id", lmb)
    ready.page.mouse.click(x, y)
    ready.wait_for("() => window.__carina.state.ui.forkHeld !== null")
    assert "Now click where the fork belongs" in ready.page.locator("[data-testid=in-hand]").inner_text()
    ready.picture("fork-in-the-hand")
    # The new position is a few millimetres back along the bronchus.
    x, y = place_on_tree(ready, lmb, 0.9)
    ready.page.mouse.move(x, y)
    ready.wait_for(PREVIEWED)
    lines = ready.state("preview.answer.lines")
    assert len(lines) >= 3, "the branch and the branches that begin at its fork"
    ready.page.mouse.click(x, y)
    wait_for_edit(ready, "move the fork", before)
    assert {str(p) for line in lines for p in line["points_lps"]} <= all_points(ready), (
        "the added line equals the preview"
    )
    moved = points_of(ready, lmb)[-1]
    assert sum((a - b) ** 2 for a, b in zip(moved, points[-1], strict=True)) ** 0.5 > 1.0
    ready.picture("fork-moved")
    undo_to(ready, before)


def test_root_of_all_paths_is_moved_and_restored_by_undo(ready):
    before = tree_text(ready)
    trachea = named(ready, "Trachea")
    root = points_of(ready, trachea)[0]
    lower = points_of(ready, trachea)[len(points_of(ready, trachea)) // 3]
    show_slices_at(ready, lower)
    ready.page.keyboard.press("Shift+B")
    x, y = place_in_slice(ready, "coronal", lower)
    ready.page.mouse.move(x, y)
    ready.page.mouse.click(x, y)
    ready.wait_for(
        """(root) => {
            const first = [...window.__carina.state.tree.byId.values()].find((n) => n.branch.parent === null);
            return Math.hypot(...first.branch.points[0].map((v, i) => v - root[i])) > 5;
        }""",
        root,
    )
    ready.picture("another-root")
    undo_to(ready, before)


def test_tri_plane_view_names_the_branch_under_the_cursor_and_draws_the_path_to_it(ready):
    lmb = named(ready, "LMB")
    points = points_of(ready, lmb)
    middle = points[len(points) // 2]
    show_slices_at(ready, middle)
    ready.page.keyboard.press("t")
    ready.wait_for("() => document.querySelector('canvas[data-view=tri-plane]')?.dataset.full === 'true'")
    x, y = place_in_tri_plane(ready, middle)
    ready.page.keyboard.press("n")
    ready.page.mouse.move(x, y)
    ready.wait_for("() => (window.__carina.state.livePath?.answer.length_mm ?? 0) > 50")
    pointed = ready.state("ui.pointedLps")
    assert max(abs(a - b) for a, b in zip(pointed, middle, strict=True)) < 3.0
    ready.picture("tri-plane-live-path")
    ready.page.keyboard.press("Escape")
    ready.page.keyboard.press("t")
