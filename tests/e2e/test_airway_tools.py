"""Tests of tools on the airway tree in the browser: path to the cursor, linked branches, edits and undo."""

from __future__ import annotations

import pytest
from page_positions import PREVIEWED, all_points, named, place_in_slice, place_on_tree, show_slices_at, tree_is_shown
from playwright.sync_api import expect
from workstation import scroll_list_to

pytestmark = pytest.mark.browser


DRAWN = "() => [...window.__carina.state.tree.byId.values()].some((node) => node.branch.kind === 'manual')"


def lung_point(workstation):
    """Return a point of lung beside the tree; the server's path to it has parts without a visible wall."""
    return workstation.page.evaluate(
        """async () => {
            const socket = window.__socket;
            let number = 900000;
            const ask = (lps) => new Promise((done) => {
                number += 1;
                const id = number;
                const heard = (event) => {
                    if (typeof event.data !== 'string' || !event.data.includes('"edit_preview"')) return;
                    const answer = JSON.parse(event.data);
                    if (answer.request_id !== id) return;
                    socket.removeEventListener('message', heard);
                    done(answer);
                };
                socket.addEventListener('message', heard);
                const place = {lps, frame_id: null, column: null, row: null};
                socket.send(JSON.stringify({
                    type: 'preview_edit', request_id: id, tool: 'add-branch', branch_id: null, with_names: false,
                    ...place,
                }));
            });
            for (const node of window.__carina.state.tree.byId.values()) {
                if (node.children.length > 0) continue;
                const [a, b] = [node.branch.points.at(-4), node.branch.points.at(-1)];
                if (a === undefined || b === undefined) continue;
                const away = b.map((v, i) => v - a[i]);
                const length = Math.hypot(...away);
                for (const mm of [8, 12, 18]) {
                    const lps = b.map((v, i) => v + (mm * away[i]) / length);
                    const answer = await ask(lps);
                    if (answer.problem === null && answer.doubtful_mm > 5) return lps;
                }
            }
            throw new Error('no such point');
        }"""
    )


def test_path_to_the_cursor_is_drawn_with_its_length_and_a_click_sets_a_target(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    tree_is_shown(workstation)
    before = workstation.overlay("coronal")
    workstation.page.keyboard.press("n")
    x, y = place_on_tree(workstation, named(workstation, "LMB"))
    workstation.page.mouse.move(x, y)
    workstation.wait_for("() => window.__carina.state.livePath?.answer.length_mm > 100")
    answer = workstation.state("livePath.answer")
    lmb = workstation.page.evaluate(
        "(id) => window.__carina.state.tree.byId.get(id).branch.points.at(-1)", named(workstation, "LMB")
    )
    assert answer["problem"] is None
    assert answer["min_diameter_mm"] > 5.0
    # The path ends in the left main bronchus, near the bronchus's end.
    assert max(abs(a - b) for a, b in zip(answer["points_lps"][-1], lmb, strict=True)) < 40.0
    workstation.picture("live-path")
    assert workstation.overlay("coronal") != before, "the path is drawn in the slices, too"

    workstation.page.mouse.click(x, y)
    workstation.wait_for("() => window.__carina.state.targets.length === 1")
    assert workstation.state("ui.armed") is None
    assert workstation.state("livePath") is None
    assert workstation.state("targets[0].problem") is None
    assert abs(workstation.state("targets[0].length_mm") - answer["length_mm"]) < 10.0
    workstation.page.keyboard.press("Control+z")
    workstation.wait_for("() => window.__carina.state.targets.length === 0")
    assert workstation.faults == []


def test_path_shown_in_the_airway_view_ends_in_the_lumen_in_front_of_the_wall(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    workstation.go_to(20.0)
    workstation.wait_still()
    workstation.page.keyboard.press("n")
    box = workstation.page.locator("canvas[data-view=airway]").bounding_box()
    workstation.page.mouse.move(box["x"] + 0.25 * box["width"], box["y"] + 0.5 * box["height"])
    workstation.wait_for("() => (window.__carina.state.livePath?.answer.length_mm ?? 0) > 20")
    assert workstation.state("livePath.answer.snapped_mm") < 1.0, "it is in the lumen, not in the wall"
    workstation.picture("live-path-in-the-airway-view")
    workstation.page.keyboard.press("Escape")
    workstation.wait_for("() => window.__carina.state.livePath === null")
    assert workstation.state("ui.armed") is None
    assert workstation.faults == []


def test_branch_is_cut_and_restored_by_undo_and_added_by_a_click_after_another_cut(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    tree_is_shown(workstation)
    whole = workstation.state("tree.byId.size")
    lmb = named(workstation, "LMB")
    end = workstation.page.evaluate("(id) => window.__carina.state.tree.byId.get(id).branch.points.at(-1)", lmb)
    # Before the click the left lung is amber from the middle of its main bronchus on.
    workstation.page.keyboard.press("k")
    x, y = place_on_tree(workstation, lmb)
    workstation.page.mouse.move(x, y)
    workstation.wait_for("(id) => window.__carina.state.ui.hovered?.branchId === id", lmb)
    workstation.picture("before-the-cut")
    workstation.page.mouse.click(x, y)
    workstation.wait_for("(n) => window.__carina.state.tree.byId.size < 0.8 * n", whole)
    cut = workstation.state("tree.byId.size")
    assert workstation.state("can_undo") == "shorten LMB"
    workstation.picture("after-the-cut")
    workstation.page.keyboard.press("Escape")
    workstation.page.keyboard.press("Control+z")
    workstation.wait_for("(n) => window.__carina.state.tree.byId.size === n", whole)
    workstation.page.keyboard.press("Control+Shift+z")
    workstation.wait_for("(n) => window.__carina.state.tree.byId.size === n", cut)

    show_slices_at(workstation, end)
    workstation.page.keyboard.press("j")
    x, y = place_in_slice(workstation, "coronal", end)
    workstation.page.mouse.move(x, y)
    workstation.wait_for(PREVIEWED)
    (line,) = workstation.state("preview.answer.lines")
    assert workstation.state("preview.answer.origin") == {"branch": "LMB", "extends": True}
    workstation.picture("before-the-addition")
    workstation.page.mouse.click(x, y)
    # The click extends LMB to the clicked point.
    workstation.wait_for(
        """(end) => 3.0 > Math.min(...[...window.__carina.state.tree.byId.values()].map((node) =>
            Math.hypot(...node.branch.points.at(-1).map((v, i) => v - end[i]))))""",
        end,
    )
    assert workstation.state("tree.byId.size") == cut
    assert {str(p) for p in line["points_lps"]} <= all_points(workstation), "the added line equals the preview"
    assert workstation.state("can_undo").startswith("add a branch")
    workstation.page.keyboard.press("Escape")
    for _ in range(2):
        workstation.page.keyboard.press("Control+z")
    workstation.wait_for("(n) => window.__carina.state.tree.byId.size === n", whole)
    assert workstation.faults == []


def test_branch_without_evidence_is_dashed_and_added_as_drawn_by_hand_after_confirmation(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    tree_is_shown(workstation)
    whole = workstation.state("tree.byId.size")
    # The point is in lung beside the end of a branch; the path to the point has no visible wall.
    lps = lung_point(workstation)
    show_slices_at(workstation, lps)
    workstation.page.keyboard.press("j")
    x, y = place_in_slice(workstation, "coronal", lps)
    workstation.page.mouse.move(x, y)
    workstation.wait_for(PREVIEWED)
    shown = workstation.state("preview.answer")
    assert not shown["has_evidence"]
    assert any(shown["lines"][0]["drawn"])
    workstation.picture("without-evidence-before-the-click")

    workstation.page.mouse.click(x, y)
    workstation.wait_for("() => window.__carina.state.doubt !== null")
    question = workstation.page.locator("[data-testid=doubt]")
    expect(question).to_contain_text("The CT shows no airway wall along")
    requested = workstation.state("doubt")
    assert requested["line"] == shown["lines"][0], "the question shows the previewed path"
    assert workstation.state("messages.length") == 0, "a question is no error"
    workstation.picture("without-evidence-the-question")
    # Esc leaves the tree unchanged and the tool active.
    workstation.page.keyboard.press("Escape")
    expect(question).to_have_count(0)
    assert workstation.state("ui.armed") == "add"
    assert workstation.state("tree.byId.size") == whole

    workstation.page.mouse.click(x, y)
    workstation.wait_for("() => window.__carina.state.doubt !== null")
    workstation.page.keyboard.press("Enter")
    workstation.wait_for(DRAWN)
    assert {str(p) for p in requested["line"]["points_lps"]} <= all_points(workstation)
    drawn = workstation.page.evaluate(
        "() => [...window.__carina.state.tree.byId.values()].find((n) => n.branch.kind === 'manual').branch"
    )
    assert drawn["confidence"] is None
    assert drawn["name"] is None
    assert drawn["doubtful_mm"] > 0
    workstation.page.keyboard.press("Escape")

    # The list, its panel and the route state that the branch was drawn by hand.
    workstation.page.get_by_role("searchbox", name="Search branches").fill("by hand")
    row = workstation.page.locator(f"[data-branch='{drawn['id']}']")
    expect(row).to_contain_text("drawn by hand")
    row.click()
    expect(workstation.page.locator("[data-testid=branch-drawn]")).to_contain_text(
        "Drawn by hand. The CT shows no wall"
    )
    workstation.wait_for("(id) => window.__carina.state.route?.branch_id === id", drawn["id"])
    assert workstation.state("route.drawn_mm") > 1.0
    assert workstation.state("route.spans").pop()["kind"] == "manual"
    workstation.picture("without-evidence-drawn-by-hand")
    workstation.page.keyboard.press("Control+z")
    workstation.page.keyboard.press("Control+z")
    workstation.wait_for("(n) => window.__carina.state.tree.byId.size === n", whole)
    assert workstation.faults == []


def test_cursor_at_a_point_without_a_path_shows_the_reason(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    workstation.page.keyboard.press("n")
    box = workstation.page.locator("canvas[data-view=axial]").bounding_box()
    workstation.page.mouse.move(box["x"] + 0.2 * box["width"], box["y"] + 0.55 * box["height"])
    workstation.wait_for("() => window.__carina.state.livePath !== null")
    assert workstation.state("livePath.answer.problem") is not None
    assert workstation.state("livePath.answer.points_lps") == []
    workstation.page.keyboard.press("Escape")
    assert workstation.faults == []


def test_hovered_branch_is_highlighted_in_the_list_and_in_all_pictures(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    tree_is_shown(workstation)
    lmb = named(workstation, "LMB")
    plain = {view: workstation.overlay(view) for view in ("tree", "coronal", "xray-coronal")}
    workstation.page.locator(f"[data-branch='{lmb}']").hover()
    workstation.wait_for("(id) => window.__carina.state.ui.hovered?.branchId === id", lmb)
    for view, before in plain.items():
        workstation.wait_for(
            "([view, before]) => document.querySelector(`[data-overlay=${view}]`).toDataURL() !== before",
            [view, before],
        )
    workstation.picture("hovered-in-the-list")

    # The link works in both directions: from the picture of the tree to the list as well.
    rmb = named(workstation, "RMB")
    x, y = place_on_tree(workstation, rmb)
    workstation.page.mouse.move(x, y)
    workstation.wait_for("(id) => window.__carina.state.ui.hovered?.branchId === id", rmb)
    row = workstation.page.get_by_role("row").filter(has=workstation.page.locator(f"[data-branch='{rmb}']")).last
    other = workstation.page.get_by_role("row").filter(has=workstation.page.locator(f"[data-branch='{lmb}']")).last

    def background(of):
        return of.evaluate("(row) => getComputedStyle(row).backgroundColor")

    assert background(row) != background(other)
    # A click in the picture flies to the branch, as a click in the list does.
    workstation.page.mouse.click(x, y)
    workstation.wait_for("(id) => window.__carina.state.route?.spans.at(-1).branch_id === id", rmb)

    # A double click enlarges the picture and chooses no branch.
    undo = workstation.state("can_undo")
    workstation.page.mouse.dblclick(*place_on_tree(workstation, lmb))
    workstation.wait_for("() => window.__carina.state.ui.full === 'outside'")
    workstation.let_pass(500)
    assert workstation.state("route.spans.at(-1).branch_id") == rmb
    assert workstation.state("can_undo") == undo
    assert workstation.state("ui.selected") == rmb
    workstation.picture("tree-large")
    workstation.page.keyboard.press("Escape")
    assert workstation.faults == []


def test_branch_is_renamed_in_place_and_the_name_is_undone(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    tip = workstation.deepest_tip(1.0)
    workstation.choose_branch(tip["id"])
    title = workstation.page.locator("[data-testid=branch-title]")
    workstation.page.keyboard.press("F2")
    field = workstation.page.locator("[data-testid=branch-name]")
    field.fill("Upper left, odd one")
    workstation.picture("renaming")
    field.press("Enter")
    workstation.wait_for(
        "(id) => window.__carina.state.tree.byId.get(id)?.branch.name === 'Upper left, odd one'", tip["id"]
    )
    assert title.inner_text() == "Upper left, odd one"
    assert workstation.state("can_undo").startswith("rename ")
    assert workstation.page.locator("[data-testid=branch-panel]").get_by_text("named by hand").count() == 1
    workstation.page.keyboard.press("Control+z")
    workstation.wait_for(
        "(id) => window.__carina.state.tree.byId.get(id)?.branch.name !== 'Upper left, odd one'", tip["id"]
    )
    assert title.inner_text() != "Upper left, odd one"

    # Esc restores the old name; afterwards keys fly again.
    workstation.page.keyboard.press("F2")
    field.press("Escape")
    expect(field).to_have_count(0)
    workstation.page.keyboard.press("m")
    workstation.wait_for("() => window.__carina.state.pose.mode === 'free'")
    workstation.page.keyboard.press("m")
    assert workstation.faults == []


def test_search_field_filters_the_branch_list(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    workstation.page.keyboard.press("/")
    workstation.page.keyboard.type("lmb")
    rows = workstation.page.locator(".branch-tree [data-branch]")
    expect(rows).to_have_count(2)
    assert [row.split()[0] for row in rows.all_inner_texts()] == ["Trachea", "LMB"]
    workstation.page.keyboard.press("Escape")
    workstation.wait_for("() => document.querySelectorAll('.branch-tree [data-branch]').length > 2")
    workstation.page.keyboard.press("Escape")
    assert workstation.faults == []


def test_preview_of_a_click_lists_the_branches_that_it_renames_when_the_cursor_rests(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    tree_is_shown(workstation)
    whole = workstation.state("tree.byId.size")
    leaf = named(workstation, "RB9")
    end = workstation.page.evaluate("(id) => window.__carina.state.tree.byId.get(id).branch.points.at(-1)", leaf)
    names = "() => [...window.__carina.state.tree.byId.values()].map((n) => [n.branch.id, n.branch.name])"
    row = workstation.page.locator(f".branch-tree [data-branch='{leaf}']")
    # The search opens the rows above the branch; a click on a row with the tool cuts the whole branch.
    workstation.page.keyboard.press("/")
    workstation.page.keyboard.type("RB9")
    workstation.page.keyboard.press("Enter")
    row.wait_for()
    workstation.page.keyboard.press("k")
    scroll_list_to(row).click()
    workstation.wait_for("(n) => window.__carina.state.tree.byId.size < n", whole)
    workstation.wait_for("() => !window.__carina.state.jobs.some((job) => job.job_id.startsWith('edit'))")
    workstation.page.keyboard.press("Escape")

    show_slices_at(workstation, end)
    workstation.page.keyboard.press("j")
    x, y = place_in_slice(workstation, "coronal", end)
    workstation.page.mouse.move(x, y)
    workstation.wait_for(PREVIEWED)
    # The first answer can precede the names that the cut changes. The next question has an answer without names first.
    has_names = "(window.__carina.state.preview?.answer?.renamed ?? []).length > 0"
    listed = workstation.once(has_names, "window.__carina.state.preview.answer.renamed")
    workstation.picture("renamed-branches-before-the-click")
    before = dict(workstation.page.evaluate(names))
    workstation.page.mouse.click(x, y)
    workstation.wait_for("(n) => window.__carina.state.tree.byId.size > n", len(before))
    workstation.wait_for("() => !window.__carina.state.jobs.some((job) => job.job_id.startsWith('edit'))")
    script = "(words) => window.__carina.state.messages.some((message) => JSON.stringify(message).includes(words))"
    workstation.wait_for(script, listed[0])
    renamed_id = next(i for i, name in before.items() if listed[0].startswith(f"{name} becomes"))
    is_renamed = "([id, name]) => window.__carina.state.tree.byId.get(id)?.branch.name !== name"
    workstation.wait_for(is_renamed, [renamed_id, before[renamed_id]])
    workstation.picture("renamed-branches-after-the-click")
    after = dict(workstation.page.evaluate(names))
    changed = {
        f"{name} becomes {after[i] or f'branch {i}'}": name
        for i, name in before.items()
        if name is not None and name != after[i]
    }
    assert set(listed) <= set(changed)
    # The new fork divides a branch, whose lower part keeps the name.
    unlisted = {name for text, name in changed.items() if text not in listed}
    assert unlisted <= {after[i] for i in after if i not in before}
    assert workstation.faults == []
