"""Tests of the views beside the airway view: C-arm, views along the route, movable planes, zoomed slices."""

from __future__ import annotations

import numpy as np
import pytest
from page_positions import drag, extent_mm, host, middle_lps

pytestmark = pytest.mark.browser


def test_c_arm_is_rotated_by_drag_and_keys_and_only_its_marker_follows_the_tip(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    workstation.page.get_by_role("radio", name="DRR").or_(workstation.page.get_by_role("button", name="DRR")).click()
    workstation.wait_picture("drr")
    workstation.picture("views-drr")
    frontal = workstation.pixels("drr")
    assert 20 < workstation.brightness("drr") < 200

    drag(workstation, "drr", (0.5, 0.5), (0.2, 0.6))
    workstation.wait_for("window.__carina.state.session.sight.carm.primary_deg > 10")
    assert workstation.state("session.sight.carm.secondary_deg") > 3
    workstation.wait_picture("drr", unlike=frontal)
    workstation.picture("views-drr-turned")

    workstation.page.locator(".picture-host:has(canvas[data-view=drr])").focus()
    workstation.page.keyboard.press("Home")
    workstation.wait_for("window.__carina.state.session.sight.carm.primary_deg === 0")
    workstation.page.keyboard.press("Shift+ArrowLeft")
    workstation.wait_for("window.__carina.state.session.sight.carm.primary_deg === 5")
    workstation.page.keyboard.press("Home")
    workstation.wait_for("window.__carina.state.session.sight.carm.primary_deg === 0")
    workstation.wait_picture("drr", like=frontal)
    workstation.page.keyboard.press("g")
    workstation.wait_for("window.__carina.state.session.sight.carm.tone === 'fluoroscopy'")
    workstation.wait_picture("drr", unlike=frontal)
    workstation.page.keyboard.press("g")
    workstation.wait_for("window.__carina.state.session.sight.carm.tone === 'radiograph'")
    workstation.wait_picture("drr", like=frontal)
    frame, marks = workstation.frame("drr"), workstation.overlay("drr")
    workstation.go_to(60.0)
    workstation.wait_still()
    assert workstation.frame("drr")["frame_id"] == frame["frame_id"], "the radiograph is not rendered again"
    assert workstation.overlay("drr") != marks, "its marker has moved"
    assert workstation.faults == []


def test_click_in_the_straightened_airway_moves_the_tip_to_the_clicked_position(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    workstation.page.keyboard.press("v")
    workstation.wait_picture("straightened")
    workstation.go_to(10.0)
    workstation.wait_still()
    workstation.picture("views-straightened")
    length = workstation.state("route.length_mm")

    box = host(workstation, "straightened")
    workstation.page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    workstation.wait_for("window.__carina.state.probed?.voxel_value < -500")
    workstation.page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    # The picture shows the whole route with margins of 8 mm, so its middle is the middle of the route.
    workstation.wait_for(f"Math.abs(window.__carina.state.pose.path_mm - {length / 2}) < 3")

    before = workstation.pixels("straightened")
    drag(workstation, "straightened", (0.3, 0.5), (0.8, 0.5))
    workstation.wait_for("window.__carina.state.session.sight.reformation.turn_deg > 20")
    workstation.wait_picture("straightened", unlike=before)
    turned = workstation.pixels("straightened")
    workstation.page.mouse.wheel(0, -600)
    workstation.wait_for("window.__carina.state.session.sight.reformation.mm_per_px < 1")
    workstation.wait_picture("straightened", unlike=turned)
    workstation.wait_still()
    workstation.picture("views-straightened-zoomed")
    frame = workstation.frame("straightened")["frame_id"]
    workstation.go_to(20.0)
    workstation.page.wait_for_function(
        "(id) => Number(document.querySelector('canvas[data-view=straightened]').dataset.frameId) > id",
        arg=frame,
    )
    workstation.page.locator(".picture-host:has(canvas[data-view=straightened])").focus()
    workstation.page.keyboard.press("Home")
    workstation.page.keyboard.press("v")
    workstation.wait_picture("curved")
    workstation.picture("views-curved")
    workstation.page.keyboard.press("v")
    workstation.wait_picture("cut-plane")
    assert workstation.faults == []


def test_plane_of_the_tri_plane_view_is_moved_by_dragging_it_and_dragging_the_background_orbits(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    workstation.page.keyboard.press("t")
    workstation.wait_picture("tri-plane")
    first = workstation.pixels("tri-plane")
    workstation.page.locator(".picture-host:has(canvas[data-view=tri-plane]) canvas.overlay").wait_for(state="attached")
    workstation.picture("views-tri-plane")
    before = workstation.state("session.sight.orbits")
    tip = [workstation.state(f"pose.lps_from_camera[{n}]") for n in (3, 7, 11)]

    drag(workstation, "tri-plane", (0.5, 0.62), (0.5, 0.5))
    workstation.wait_for("window.__carina.state.session.sight.crosshair_lps !== null")
    workstation.wait_still()
    crosshair = workstation.state("session.sight.crosshair_lps")
    moved = np.abs(np.subtract(crosshair, tip))
    # The plane moves along one axis only.
    assert (moved > 3.0).sum() == 1
    assert (moved < 0.2).sum() == 2
    assert workstation.state("session.sight.orbits") == before
    workstation.wait_picture("tri-plane", unlike=first)
    workstation.picture("views-tri-plane-moved")

    workstation.page.locator(".picture-host:has(canvas[data-view=tri-plane])").focus()
    workstation.page.keyboard.press("PageDown")
    workstation.wait_for(f"window.__carina.state.session.sight.crosshair_lps[2] < {crosshair[2] - 0.5}")
    workstation.page.keyboard.press("Control+ArrowRight")
    workstation.wait_for(f"window.__carina.state.session.sight.crosshair_lps[0] > {crosshair[0] + 0.5}")
    workstation.page.keyboard.press("Control+ArrowDown")
    workstation.wait_for(f"window.__carina.state.session.sight.crosshair_lps[1] < {crosshair[1] - 0.5}")
    # The key "." adds a key frame in this view as in all others, and moves no plane.
    here = workstation.state("session.sight.crosshair_lps")
    workstation.page.keyboard.press(".")
    workstation.wait_for("window.__carina.state.keyFrames.frames.length === 1")
    assert workstation.state("session.sight.crosshair_lps") == here
    workstation.page.keyboard.press("Control+z")
    workstation.wait_for("window.__carina.state.keyFrames.frames.length === 0")
    workstation.page.locator(".picture-host:has(canvas[data-view=tri-plane])").focus()
    drag(workstation, "tri-plane", (0.03, 0.03), (0.3, 0.03))
    workstation.wait_for("window.__carina.state.session.sight.orbits['tri-plane'] !== undefined")
    workstation.page.keyboard.press("c")
    workstation.wait_for("window.__carina.state.session.sight.crosshair_lps === null")
    assert workstation.faults == []


def test_slice_zooms_about_the_cursor_and_shows_a_thick_slab(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    workstation.wait_picture("axial")
    plain = workstation.pixels("axial")
    box = host(workstation, "axial")
    at = (box["x"] + 0.3 * box["width"], box["y"] + 0.4 * box["height"])
    workstation.page.mouse.move(*at)
    workstation.wait_for("window.__carina.state.probed !== null")
    here = workstation.state("ui.cursorLps")
    workstation.page.keyboard.down("Control")
    for _ in range(3):
        workstation.page.mouse.wheel(0, -150)
    workstation.page.keyboard.up("Control")
    workstation.wait_for("window.__carina.state.session.sight.zoom.axial?.mm_per_px != null")
    workstation.wait_still()
    workstation.wait_picture("axial", unlike=plain)
    workstation.wait_for(
        "((m, place) => Math.abs(Math.hypot(m[0], m[4], m[8]) - place.mm_per_px) < 1e-3)"
        "(window.__carina.state.frames.axial.lps_from_pixel, window.__carina.state.session.sight.zoom.axial)",
    )
    workstation.page.mouse.move(at[0] + 1, at[1])
    workstation.page.mouse.move(*at)
    workstation.wait_still()
    # The point under the cursor stays; a pixel of the small picture is about a millimetre.
    np.testing.assert_allclose(workstation.state("ui.cursorLps"), here, atol=1.5)
    workstation.picture("views-slice-zoomed")

    thin = workstation.pixels("coronal")
    workstation.page.mouse.move(5, 400)
    workstation.page.keyboard.press("i")
    workstation.wait_for("window.__carina.state.session.sight.slab.thickness_mm === 10")
    workstation.wait_picture("coronal", unlike=thin)
    workstation.picture("views-slab")
    # Three presses at once add up: each starts from the last request, even if the server has not answered it.
    for _ in range(3):
        workstation.page.keyboard.press("i")
    workstation.wait_for("window.__carina.state.session.sight.slab.thickness_mm === 0")
    assert workstation.faults == []


@pytest.mark.parametrize("view", ["coronal", "cut-plane"])
def test_picture_is_panned_by_middle_drag_shift_drag_and_keys_and_fitted_to_the_window_again(server, workstation, view):
    workstation.open(server)
    workstation.wait_ready()
    workstation.wait_picture(view)
    fitted, first_mm = workstation.pixels(view), extent_mm(workstation, view)
    first = middle_lps(workstation, view)
    crosshair = workstation.state("session.sight.crosshair_lps")
    box = host(workstation, view)
    mm_per_css = first_mm / box["width"]
    header = workstation.state(f"frames['{view}']")
    axes = np.reshape(header["lps_from_pixel"], (4, 4))[:3, :2]
    right, down = (axes / np.linalg.norm(axes, axis=0)).T

    def settled_at(expected):
        """Wait for the picture in full quality around the point ``expected``."""
        text = ",".join(str(float(v)) for v in expected)
        workstation.wait_for(
            f"""((h) => h.full && Math.hypot(...[{text}].map((v, n) =>
                h.lps_from_pixel[4 * n] * h.width / 2 + h.lps_from_pixel[4 * n + 1] * h.height / 2
                + h.lps_from_pixel[4 * n + 3] - v)) < 0.02 * {first_mm})(window.__carina.state.frames['{view}'])""",
        )

    drag(workstation, view, (0.5, 0.5), (0.6, 0.4), button="middle")
    moved = first - (0.1 * box["width"] * right - 0.1 * box["height"] * down) * mm_per_css
    settled_at(moved)
    assert extent_mm(workstation, view) == pytest.approx(first_mm, rel=0.01), "a pan does not zoom"
    assert workstation.state("session.sight.crosshair_lps") == crosshair, "a pan moves no crosshair"

    workstation.page.keyboard.down("Shift")
    mouse = workstation.page.mouse
    mouse.down()
    mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"], steps=6)
    mouse.up()
    workstation.page.keyboard.up("Shift")
    settled_at(first)
    workstation.picture(f"views-panned-{view}")

    workstation.page.locator(f".picture-host:has(canvas[data-view={view}])").focus()
    workstation.page.keyboard.press("Control+ArrowRight")
    settled_at(first + 40 * mm_per_css * right)
    workstation.page.keyboard.press("+")
    workstation.wait_for(f"window.__carina.state.frames['{view}'].full")
    workstation.page.locator(f"[data-testid=fit-{view}]").click()
    workstation.page.locator(f"[data-testid=fit-{view}]").wait_for(state="detached")
    settled_at(first)
    workstation.wait_picture(view, like=fitted)
    assert workstation.faults == []
