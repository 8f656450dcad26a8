"""Tests of the details of a plan in the browser: C-arm angles, lymph node stations, and the comparison of targets."""

from __future__ import annotations

import json

import numpy as np
import pytest
import SimpleITK as sitk
from test_plan import CHEST
from workstation import PICTURE_MS

from cached_test_data import cached_phantom
from carina.render import DrrView
from carina.render.radiograph import cast_drr

pytestmark = pytest.mark.browser

SIZES = [(1280, 800), (1440, 900), (1920, 1080)]


def of_sizes(*usual: int) -> pytest.MarkDecorator:
    """Return the mark that repeats a test in windows of all sizes; all but the ``usual`` widths run in `make soak`."""
    return pytest.mark.parametrize(
        "size",
        [pytest.param(size, marks=() if size[0] in usual else pytest.mark.soak) for size in SIZES],
        ids=[str(width) for width, _ in SIZES],
    )


NEEDLE, LESION, STATION = (255, 255, 255), (183, 156, 255), (255, 179, 199)
"""RGB colours in which the overlays draw the planned tip, the target and the lymph node station."""


@pytest.fixture
def opens(tmp_path, request, shared_chest):
    """Return a chest with a nodule, as the opened file; with the parameter *mirrored*, its columns are reversed."""
    chest = shared_chest(**CHEST)
    if getattr(request, "param", None) != "mirrored":
        return chest
    # A negative step reverses the voxels and their direction, so that the patient stays where it is.
    mirrored = sitk.ReadImage(chest["path"])[::-1, :, :]
    assert np.linalg.det(np.reshape(mirrored.GetDirection(), (3, 3))) < 0.0
    path = str(tmp_path / "ct.nii.gz")
    sitk.WriteImage(mirrored, path)
    return {"path": path}


def add_target(workstation, lps) -> None:
    """Add a target by its coordinates in the step *Target*."""
    page = workstation.page
    count = len(workstation.state("session.targets"))
    page.get_by_role("button", name="Target", exact=True).first.click()
    field = page.get_by_test_id("coordinates").locator("input")
    field.fill(", ".join(f"{v:.2f}" for v in lps))
    field.press("Enter")
    workstation.wait_for("(count) => window.__carina.state.session.targets.length > count", count)


def take_best_route(workstation) -> None:
    """Add the nodule as a target, and choose its best route."""
    add_target(workstation, cached_phantom(**CHEST).truth["nodule"]["centre_lps"])
    workstation.wait_while_working("window.__carina.state.plans?.targets[0]?.routes.length > 0")
    page = workstation.page
    wide = page.viewport_size["width"] >= 1600
    page.get_by_test_id("answer-take-route" if wide else "take-route").click()


def nearest_px(
    workstation, view: str, colour: tuple[int, int, int], at: tuple[float, float], most_off: int = 12
) -> float:
    """Return the distance in CSS px from a place in a view to the nearest overlay pixel of a colour."""
    return workstation.page.evaluate(
        """([view, colour, at, most]) => {
            const layer = document.querySelector(`[data-overlay=${view}]`);
            const { width, height } = layer;
            const data = layer.getContext('2d').getImageData(0, 0, width, height).data;
            let best = Infinity;
            for (let n = 0; n < width * height; n += 1) {
                const off = Math.max(...colour.map((value, c) => Math.abs(value - data[4 * n + c])));
                if (data[4 * n + 3] < 150 || off > most) continue;
                best = Math.min(best, Math.hypot((n % width) + 0.5 - at[0], Math.floor(n / width) + 0.5 - at[1]));
            }
            return best;
        }""",
        [view, list(colour), list(at), most_off],
    )


def place_in_radiograph(workstation, lps, centre_lps) -> tuple[float, float]:
    """Return the place of a point in the radiograph by the geometry of a C-arm, in CSS px of the view.

    The detector is in front of a supine patient at LAO 0. LAO turns it to the patient's left, cranial to the head. The
    picture is seen from the detector: the patient's left is on the right.
    """
    arm, header = workstation.state("sight.carm"), workstation.state("frames.drr")
    a, b = np.radians([arm["primary_deg"], arm["secondary_deg"]])
    out = np.array([np.sin(a) * np.cos(b), -np.cos(a) * np.cos(b), np.sin(b)])
    right = np.array([np.cos(a), np.sin(a), 0.0])
    up = np.array([-np.sin(a) * np.sin(b), np.cos(a) * np.sin(b), np.cos(b)])
    ray = np.array(lps) - centre_lps + DrrView().sod_mm * out
    shorter = min(header["width"], header["height"])
    focus_px = 0.5 * shorter / np.tan(np.radians(0.5 * header["fov_deg"]))
    box = workstation.page.locator("canvas[data-view=drr]").bounding_box()
    scale = box["width"] / header["width"]
    x = 0.5 * header["width"] + focus_px * (ray @ right) / (ray @ out)
    y = 0.5 * header["height"] - focus_px * (ray @ up) / (ray @ out)
    return float(x * scale), float(y * scale)


def plan_with_c_arm(server, workstation, size):
    """Open the chest in a window of a size, choose the best route, and return the page and the C-arm angles."""
    workstation.page.set_viewport_size({"width": size[0], "height": size[1]})
    workstation.open(server)
    workstation.wait_ready()
    take_best_route(workstation)
    workstation.wait_while_working("window.__carina.state.plans.carm_standing === 'had'")
    angles = workstation.state("plans.carm.angles")
    assert angles
    return workstation.page, angles


def show_c_arm_angles(workstation, angles, name: str) -> None:
    """Show each angle in the X-ray view, and compare the marks of target and planned tip with the geometry."""
    page = workstation.page
    for number, one in enumerate(angles, 1):
        page.get_by_test_id(f"show-carm-{number}").click()
        workstation.wait_for(
            "([a, b]) => { const { carm } = window.__carina.state.sight;"
            " return carm.primary_deg === a && carm.secondary_deg === b; }",
            [one["primary_deg"], one["secondary_deg"]],
        )
        assert "drr" in workstation.shown_views()
        page.get_by_text("Shown in the X-ray view", exact=True).wait_for()
        # The picture of the new angles arrives after the state; its camera looks along the new direction.
        a, b = np.radians([one["primary_deg"], one["secondary_deg"]])
        out = [float(np.sin(a) * np.cos(b)), float(-np.cos(a) * np.cos(b)), float(np.sin(b))]
        workstation.wait_for(
            "(out) => { const m = window.__carina.state.frames.drr.lps_from_camera;"
            " return Math.abs(Math.abs(out[0] * m[2] + out[1] * m[6] + out[2] * m[10]) - 1) < 1e-4; }",
            out,
        )
        workstation.refreshes(3)
        workstation.picture(f"{name}-{number}")
        centre = cached_phantom(**CHEST).volume.centre_lps
        leg = workstation.state("plans.targets[0].routes[0].leg")
        tip = place_in_radiograph(workstation, leg["tip_lps"], centre)
        target = place_in_radiograph(workstation, workstation.state("plans.targets[0].centre_lps"), centre)
        # The mark of the planned tip is a diamond with half a width of 5 px; the target is a filled outline.
        for right, down in ((5, 0), (-5, 0), (0, 5), (0, -5)):
            # A thin line between two rows of pixels is not pure white.
            assert nearest_px(workstation, "drr", NEEDLE, (tip[0] + right, tip[1] + down), most_off=60) < 2.5
        assert nearest_px(workstation, "drr", LESION, target) < 12.0


# The angles and their marks do not depend on the layout of the window.
@of_sizes(1440)
def test_c_arm_angles_are_listed_and_shown_in_the_x_ray_with_target_and_planned_tip(server, workstation, size):
    page, angles = plan_with_c_arm(server, workstation, size)
    listed = page.get_by_test_id("carm-angles")
    assert listed.locator("li > span").all_inner_texts() == [one["words"] for one in angles]
    show_c_arm_angles(workstation, angles, f"carm-{size[0]}")
    if size[0] == 1440:
        with page.expect_download() as taken:
            page.get_by_test_id("take-plan.json").click()
        document = json.loads(taken.value.path().read_text())
        text = [one["words"] for one in document["c_arm"]["angles"]]
        assert text == [one["words"] for one in angles]
    assert workstation.faults == []


@pytest.mark.parametrize("opens", ["mirrored"], indirect=True)
def test_c_arm_angles_of_a_ct_with_mirrored_columns_show_the_correct_side(server, workstation):
    _, angles = plan_with_c_arm(server, workstation, SIZES[1])
    show_c_arm_angles(workstation, angles[:1], "carm-mirrored")
    # The picture equals that of the CT with columns in the usual order, and not its mirror image.
    header, arm = workstation.state("frames.drr"), workstation.state("sight.carm")
    view = DrrView(
        primary_deg=arm["primary_deg"],
        secondary_deg=arm["secondary_deg"],
        width=header["width"],
        height=header["height"],
    )
    expected = cast_drr(cached_phantom(**CHEST).volume, view).rgb[..., 0].astype(float)
    rows, columns = (np.arange(32) * side // 32 for side in expected.shape)
    expected = np.add.reduceat(np.add.reduceat(expected, rows, axis=0), columns, axis=1)
    shown = np.reshape(workstation.pixels("drr"), (32, 32, 4))[..., 0].astype(float)
    right, wrong = (np.corrcoef(shown.ravel(), one.ravel())[0, 1] for one in (expected, expected[:, ::-1]))
    assert abs(right) > 0.8 and abs(right) > abs(wrong) + 0.05
    assert workstation.faults == []


def test_station_of_a_route_is_shown_in_the_slices_by_click_and_key(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    page = workstation.page
    take_best_route(workstation)
    workstation.wait_for("window.__carina.state.plans.targets[0].stations.length > 1")
    stations = workstation.state("plans.targets[0].stations")
    page.get_by_test_id("route-station-1").wait_for()
    rows = page.get_by_test_id("route-stations").locator("li button")
    assert rows.all_inner_texts() == [one["head"][0].upper() + one["head"][1:] for one in stations]
    pose = workstation.state("pose.lps_from_camera")
    for number, one in enumerate(stations, 1):
        row = page.get_by_test_id(f"route-station-{number}")
        if number == 2:
            row.press("Enter")
        else:
            row.click()
        workstation.wait_for(
            "(at) => Math.hypot(...window.__carina.state.session.sight.crosshair_lps.map((v, n) => v - at[n])) < 0.01",
            one["point_lps"],
        )
        workstation.wait_for(
            "(z) => Math.abs(window.__carina.state.frames.axial.lps_from_pixel[11] - z) < 1.0", one["point_lps"][2]
        )
        workstation.refreshes(3)
        place = workstation.page.evaluate(
            """(p) => {
                const { lps_from_pixel: m, width } = window.__carina.state.frames.axial;
                const box = document.querySelector('canvas[data-view=axial]').getBoundingClientRect();
                const host = document.querySelector('[data-overlay=axial]').getBoundingClientRect();
                const scale = box.width / width;
                return [box.x - host.x + scale * (p[0] - m[3]) / m[0], box.y - host.y + scale * (p[1] - m[7]) / m[5]];
            }""",
            one["point_lps"],
        )
        assert nearest_px(workstation, "axial", STATION, place) < 6.0
        workstation.picture(f"station-{number}")
    # The tip stays where it is.
    assert workstation.state("pose.lps_from_camera") == pose
    # An operator who faces the patient reads the clock hours for that position.
    page.keyboard.press("f")
    workstation.wait_for("window.__carina.state.look.operator === 'facing'")
    assert rows.all_inner_texts() == [one["facing"][0].upper() + one["facing"][1:] for one in stations]
    assert workstation.faults == []


# The table is narrowest in the narrowest window; the layout of the plan changes between 1440 and 1920 px.
@of_sizes(1280, 1920)
def test_targets_are_compared_in_one_table_and_a_click_on_a_row_selects_its_target(server, workstation, size):
    workstation.page.set_viewport_size({"width": size[0], "height": size[1]})
    workstation.open(server)
    workstation.wait_ready()
    page = workstation.page
    x, y, z = cached_phantom(**CHEST).truth["nodule"]["centre_lps"]
    add_target(workstation, (x, y, z))
    assert page.get_by_test_id("compare-targets").count() == 0
    add_target(workstation, (x + 1.0, y, z))
    # The tip is in the airway: the third target has no size, and so no plan.
    pose = workstation.state("pose.lps_from_camera")
    add_target(workstation, pose[3::4][:3])
    workstation.wait_while_working("window.__carina.state.plans.comparison?.targets.length === 2")
    comparison = workstation.state("plans.comparison")
    plans = {one["target_id"]: one for one in workstation.state("plans.targets")}
    names = {one["target_id"]: one["name"] for one in workstation.state("session.targets")}

    page.get_by_test_id("compare-targets").focus()
    page.keyboard.press("Enter")
    table = page.get_by_test_id("comparison")
    table.wait_for()
    rows = table.get_by_test_id("compared")
    assert comparison["order"] in table.inner_text()
    assert rows.get_by_role("rowheader").all_inner_texts() == [names[o["target_id"]] for o in comparison["targets"]]
    for row, one in zip(rows.all(), comparison["targets"], strict=True):
        route = plans[one["target_id"]]["routes"][0]
        text = row.inner_text()
        assert route["outlook"] in text
        assert f"{route['leg']['to_target_mm']:.0f}\u202fmm" in text and f"{route['narrowest_mm']:.1f}" in text
    assert "not planned" in table.get_by_test_id("unplanned").inner_text().lower()
    # The table fits the window: it does not scroll sideways, and the dialog is inside the window.
    scroll = table.locator(".routes-scroll").evaluate("(box) => [box.clientWidth, box.scrollWidth]")
    assert scroll[1] <= scroll[0]
    box = table.bounding_box()
    assert box["x"] >= 0 and box["x"] + box["width"] <= size[0] and box["y"] + box["height"] <= size[1]
    workstation.picture(f"comparison-{size[0]}")

    # The second row is chosen by the keyboard alone.
    second = comparison["targets"][1]["target_id"]
    for _ in range(12):
        if page.evaluate("() => document.activeElement.dataset.testid") == f"choose-{second}":
            break
        page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    workstation.wait_for("(id) => window.__carina.state.route?.target_id === id", second)
    table.wait_for(state="detached", timeout=PICTURE_MS)
    assert workstation.state("ui.step") == "route"
    assert workstation.state("pose.lps_from_camera")[3::4][:3] == pytest.approx(pose[3::4][:3], abs=0.5)
    page.get_by_test_id("compare-targets").click()
    assert table.locator("tr[aria-current]").get_by_role("rowheader").inner_text() == names[second]
    page.keyboard.press("Escape")
    table.wait_for(state="detached", timeout=PICTURE_MS)
    assert workstation.faults == []
