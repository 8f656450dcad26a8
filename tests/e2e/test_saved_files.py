"""Journey: pictures of views and a video of a flight are saved in the window, and other programs read them."""

from __future__ import annotations

import base64
import os
import shutil
import subprocess

import numpy as np
import pytest
from workstation import OUT, assert_accessible

from carina.render import read_png_pose

av = pytest.importorskip("av", reason="PyAV is not installed")
pytestmark = pytest.mark.browser


@pytest.fixture
def opened(host, workstation, tmp_path):
    """Return the page of the phantom on a short route."""
    workstation.open(host.open(demo="phantom", home=str(tmp_path / "home")))
    workstation.wait_ready()
    return workstation


def pixels(path):
    with av.open(str(path)) as container:
        return next(container.decode(video=0)).to_ndarray(format="rgb24")


def download(page, folder, press):
    """Press a button, and return the path of the file that the browser downloads, with the name that it suggests."""
    with page.expect_download(timeout=600_000) as waiting:
        press()
    path = folder / waiting.value.suggested_filename
    waiting.value.save_as(path)
    return path


def plays_in_browser(page, film):
    """Return whether the browser decodes a video, in a page of another site."""
    other = page.context.new_page()
    try:
        data = base64.b64encode(film.read_bytes()).decode()
        other.set_content("<video muted></video>")
        return other.evaluate(
            """(data) => new Promise((done) => {
                const video = document.querySelector('video');
                video.onloadeddata = () => done(video.videoWidth === 640 && video.duration > 1);
                video.onerror = () => done(false);
                video.src = `data:video/mp4;base64,${data}`;
            })""",
            data,
        )
    finally:
        other.close()


def open_menu(page, view):
    page.get_by_test_id(f"picture-menu-{view}").click()
    page.get_by_test_id("picture-save").wait_for()


@pytest.mark.parametrize("size", [(1280, 720), (1920, 1080)], ids=lambda size: f"{size[0]}")
def test_header_of_each_view_saves_a_picture(opened, tmp_path, size):
    page = opened.page
    page.set_viewport_size({"width": size[0], "height": size[1]})
    opened.wait_still()
    opened.picture(f"picture-headers-{size[0]}")
    open_menu(page, "axial")
    opened.picture(f"picture-menu-{size[0]}")
    marked = download(page, tmp_path, lambda: page.get_by_test_id("picture-save").click())
    assert marked.name == "axial.png"
    # After a click the keys steer the flight again.
    opened.wait_for("document.activeElement === document.body")
    box = page.locator("canvas[data-view=axial]").bounding_box()
    assert pixels(marked).shape[:2] == pytest.approx((box["height"], box["width"]), abs=1)
    assert read_png_pose(marked)["view"] == "axial"
    open_menu(page, "axial")
    page.get_by_role("radio", name="2×").click()
    large = download(page, tmp_path, lambda: page.get_by_test_id("picture-save").click())
    assert pixels(large).shape[0] == pytest.approx(2 * box["height"], abs=2)
    # The tree has no single scale, so its switch is disabled; the key saves the focused view.
    open_menu(page, "tree")
    assert page.get_by_test_id("picture-scale").is_disabled()
    page.keyboard.press("Escape")
    # The menu returns the focus when it has closed, which would take it from the view.
    page.get_by_test_id("picture-save").wait_for(state="detached")
    opened.wait_for("document.activeElement === document.body || document.activeElement.closest('header') !== null")
    page.locator(".picture-host:has(canvas[data-view=coronal])").focus()
    opened.wait_for("document.activeElement.classList.contains('picture-host')")
    by_key = download(page, tmp_path, lambda: page.keyboard.press("Shift+P"))
    assert by_key.name == "coronal.png"
    page.locator("[data-cell=axial] header").get_by_role("button", name="Full view").click()
    opened.wait_for("window.__carina.state.ui.full === 'axial'")
    opened.wait_for("window.__carina.state.frames.axial !== undefined")
    of_full = download(page, tmp_path, lambda: page.keyboard.press("Shift+P"))
    assert of_full.name == "axial.png"


def test_picture_is_copied_or_saved_where_the_browser_blocks_the_clipboard(opened, tmp_path):
    page = opened.page
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    open_menu(page, "airway")
    page.get_by_test_id("picture-copy").click()
    page.get_by_text("Picture copied.").wait_for()
    kinds = page.evaluate("async () => (await navigator.clipboard.read()).flatMap((item) => [...item.types])")
    assert "image/png" in kinds
    page.evaluate("() => { navigator.clipboard.write = () => Promise.reject(new Error('not allowed')); }")
    open_menu(page, "airway")
    saved = download(page, tmp_path, lambda: page.get_by_test_id("picture-copy").click())
    assert saved.name == "airway.png"
    page.get_by_text("the picture was saved").wait_for()


def test_video_of_a_short_route_is_saved_and_played_by_other_programs(opened, tmp_path):
    page = opened.page
    root = page.evaluate(
        "() => [...window.__carina.state.tree.byId.values()].find(({branch}) => branch.parent === null).branch.id"
    )
    opened.choose_branch(root)
    opened.wait_for("window.__carina.state.route.forks_mm.length === 0")
    for width, height in ((1280, 720), (1920, 1080)):
        page.set_viewport_size({"width": width, "height": height})
        page.keyboard.press("Shift+V")
        page.get_by_test_id("film-dialog").wait_for()
        opened.picture(f"film-dialog-{width}")
        assert_accessible(opened.page, "film-dialog")
        page.keyboard.press("Escape")
        page.get_by_test_id("film-dialog").wait_for(state="detached")
    page.keyboard.press("Shift+V")
    page.get_by_role("radio", name="640 × 480").click()
    page.get_by_test_id("film-speed").click()
    page.get_by_role("option", name="80 mm/s").click()
    film = download(page, tmp_path, lambda: page.get_by_test_id("film-save").click())
    assert film.name == "flight.mp4"
    with av.open(str(film)) as container:
        stream = container.streams.video[0]
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
        assert (stream.width, stream.height, float(stream.average_rate)) == (640, 480, 30.0)
        assert stream.profile == "Main"
    assert len(frames) > 30
    assert np.abs(frames[0].astype(int) - frames[-1]).mean() > 3
    assert plays_in_browser(page, film)
    if shutil.which("ffprobe") is not None:
        seen = subprocess.run(["ffprobe", "-v", "error", str(film)], capture_output=True, text=True, check=True)
        assert seen.stderr == ""


def test_forks_of_a_route_are_saved_as_one_picture(opened, tmp_path):
    page = opened.page
    first = page.evaluate(
        "() => [...window.__carina.state.tree.byId.values()].find(({branch}) => branch.name === 'RMB').branch.id"
    )
    opened.choose_branch(first)
    opened.wait_for("window.__carina.state.route.title === 'RMB'")
    page.get_by_role("button", name="Route", exact=True).click()
    page.get_by_test_id("save-forks").scroll_into_view_if_needed()
    opened.pictures("route-files", [(1280, 720), (1920, 1080)])
    sheet = download(page, tmp_path, lambda: page.get_by_test_id("save-forks").click())
    assert sheet.name == "forks.png"
    height, width = pixels(sheet).shape[:2]
    assert height > 384
    assert width >= 384
    if os.environ.get("CARINA_PICTURES"):
        shutil.copy(sheet, OUT / "forks-sheet.png")


def test_reload_of_the_page_does_not_lose_a_video(opened, tmp_path):
    page = opened.page
    root = page.evaluate(
        "() => [...window.__carina.state.tree.byId.values()].find(({branch}) => branch.parent === null).branch.id"
    )
    opened.choose_branch(root)
    opened.wait_for("window.__carina.state.route.forks_mm.length === 0")
    page.keyboard.press("Shift+V")
    page.get_by_role("radio", name="640 × 480").click()
    assert page.get_by_role("button", name="Captions").get_attribute("aria-pressed") == "true"
    page.get_by_test_id("film-save").click()
    opened.wait_for("sessionStorage.getItem('carina.film') !== null")
    film = download(page, tmp_path, page.reload)
    assert film.name == "flight.mp4"
    opened.wait_for("!window.__carina.state.ui.filming")
    assert page.evaluate("() => sessionStorage.getItem('carina.film')") is None


def test_cancelled_video_saves_no_file_and_another_can_be_saved(opened):
    page = opened.page
    page.keyboard.press("Shift+V")
    page.get_by_test_id("film-save").click()
    cancel = page.get_by_label("saving the video").get_by_role("button", name="Cancel")
    cancel.wait_for()
    opened.picture("film-job")
    downloads = []

    def downloaded(file):
        downloads.append(file)

    page.on("download", downloaded)
    cancel.click()
    opened.wait_for("!window.__carina.state.ui.filming && window.__carina.state.jobs.length === 0")
    assert downloads == []
    assert opened.state("messages.filter((message) => message.kind === 'error').length") == 0
    page.keyboard.press("Shift+V")
    page.get_by_test_id("film-save").wait_for()
