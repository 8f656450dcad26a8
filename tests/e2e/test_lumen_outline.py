"""Tests of the found lumen's outline over the CT in the browser: position, key, and places to check."""

from __future__ import annotations

import base64

import numpy as np
import pytest
import SimpleITK as sitk

from cached_test_data import patient

pytestmark = pytest.mark.browser

# The outline has a colour that no other mark has.
OUTLINE_PIXELS = """(view) => {
    const canvas = document.querySelector(`[data-overlay=${view}]`);
    const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
    const found = [];
    for (let n = 0; n < data.length; n += 4) {
        const off = Math.abs(data[n] - 240) + Math.abs(data[n + 1] - 140) + Math.abs(data[n + 2] - 224);
        if (data[n + 3] > 150 && off < 24) found.push([(n / 4) % canvas.width, Math.floor(n / 4 / canvas.width)]);
    }
    return { width: canvas.width, height: canvas.height, pixels: found };
}"""


@pytest.fixture
def opens():
    """Return the options of ``carina demo patient``: voxels of 0.66 x 0.66 x 3 mm, with airways that have open ends."""
    return {"demo": "patient"}


def lumen_of(workstation, folder):
    """Return the lumen as the product exports it, (nz, ny, nx), and the matrix ``ijk_from_lps``."""
    data = workstation.page.evaluate(
        """async () => {
            const bytes = new Uint8Array(await (await fetch('/api/airways.nrrd')).arrayBuffer());
            let text = '';
            for (let n = 0; n < bytes.length; n += 32768) text += String.fromCharCode(...bytes.slice(n, n + 32768));
            return btoa(text);
        }"""
    )
    path = folder / "lumen.nrrd"
    path.write_bytes(base64.b64decode(data))
    image = sitk.ReadImage(str(path))
    matrix = np.eye(4)
    matrix[:3, :3] = np.reshape(image.GetDirection(), (3, 3)) * image.GetSpacing()
    matrix[:3, 3] = image.GetOrigin()
    return sitk.GetArrayFromImage(image), np.linalg.inv(matrix)


def near_sides(lumen_zyx, ijk, reach):
    """Return whether lumen voxels, and whether others, are within ``reach`` (n, 3) of voxel coordinates (n, 3)."""
    nearest = np.rint(ijk).astype(int)
    found = np.zeros((2, len(ijk)), dtype=bool)
    shape = np.array(lumen_zyx.shape[::-1])
    for offset in np.stack(np.meshgrid(*[[-1, 0, 1]] * 3), axis=-1).reshape(-1, 3):
        voxel = nearest + offset
        off = np.maximum(np.abs(ijk - voxel) - 0.5, 0.0) / reach
        held = ((voxel >= 0) & (voxel < shape)).all(axis=1)
        i, j, k = np.clip(voxel, 0, shape - 1).T
        is_lumen = held & (lumen_zyx[k, j, i] != 0)
        close = np.linalg.norm(off, axis=1) <= 1.0
        found[0] |= is_lumen & close
        found[1] |= ~is_lumen & close
    return found


def drawn_outline(workstation, view):
    """Return the positions of the outline's pixels in picture coordinates, and the header of the picture."""
    workstation.page.mouse.move(5, 300)
    workstation.settle()
    # Picture and overlay are read in the same moment, so they belong together.
    seen = workstation.page.evaluate(f"() => [({OUTLINE_PIXELS})('{view}'), window.__carina.state.frames['{view}']]")
    drawn, header = seen
    pixels = np.array(drawn["pixels"], dtype=np.float64).reshape(-1, 2) + 0.5
    return pixels * (header["width"] / drawn["width"], header["height"] / drawn["height"]), header


def to_ijk(places, header, ijk_from_lps):
    matrix = ijk_from_lps @ np.reshape(header["lps_from_pixel"], (4, 4))
    return places @ matrix[:3, :2].T + matrix[:3, 3]


@pytest.mark.parametrize("view", ["cut-plane", "coronal"])
def test_lumen_outline_on_a_zoomed_slice_is_within_half_a_voxel_of_the_lumen(server, workstation, tmp_path, view):
    workstation.open(server)
    workstation.wait_ready()
    length = workstation.state("route.length_mm")
    # Before this lobe the cut-plane is oblique to all axes.
    workstation.go_to(0.7 * length)
    workstation.wait_still()
    written, ijk_from_lps = lumen_of(workstation, tmp_path)
    # The outline shows the lumen that the brush edits; the exported lumen extends to the half-maximum, at most a voxel
    # farther.
    lumen = patient()[1].lumen_zyx
    assert not ((lumen != 0) & (written == 0)).any()
    workstation.page.locator(f".cell:has(canvas[data-view={view}]) header button").last.click()
    workstation.wait_for("window.__carina.state.ui.full !== null")
    host = workstation.page.locator(f".picture-host:has(canvas[data-view={view}])")
    host.focus()
    first = workstation.state(f"frames['{view}'].frame_id")
    for _ in range(5):
        workstation.page.keyboard.press("+")
    workstation.wait_for(f"window.__carina.state.session.sight.zoom['{view}'] !== undefined")
    workstation.wait_for(
        f"((h) => h.full && h.frame_id > {first} && h.width > 500)(window.__carina.state.frames['{view}'])",
    )
    workstation.wait_still()
    workstation.wait_picture(view)
    places, header = drawn_outline(workstation, view)
    workstation.picture(f"outline-{view}")
    columns = np.reshape(header["lps_from_pixel"], (4, 4))[:3, :2]
    if view == "cut-plane":
        normal = np.cross(*columns.T)
        assert np.abs(normal / np.linalg.norm(normal)).max() < 0.98, "the plane is oblique"
    assert len(places) > 300

    # The tolerance is half a voxel, plus half of the width of the line and the edge of its last pixel.
    mm_per_px = float(np.linalg.norm(columns[:, 0]))
    spacing = 1.0 / np.linalg.norm(ijk_from_lps[:3, :3], axis=1)
    reach = 0.5 + 1.5 * mm_per_px / spacing
    lumen_near, other_near = near_sides(lumen, to_ijk(places, header, ijk_from_lps), reach)
    assert lumen_near.all()
    assert other_near.all()

    # The outline is complete: where the mask changes between two pixels, the line is within a voxel.
    rows = np.arange(3.0, header["height"] - 3.0, 4.0)
    spots = np.array([(c, r) for r in rows for c in np.arange(3.0, header["width"] - 3.0)])
    i, j, k = np.clip(np.rint(to_ijk(spots, header, ijk_from_lps)).astype(int), 0, np.array(lumen.shape[::-1]) - 1).T
    inside = (lumen[k, j, i] != 0).reshape(len(rows), -1)
    changes = spots.reshape(len(rows), -1, 2)[:, 1:][inside[:, 1:] != inside[:, :-1]]
    away_px = np.sqrt(((changes[:, None] - places[None]) ** 2).sum(axis=2).min(axis=1))
    assert len(changes) > 20
    # The limit is below 1, because the mark of the tip and the dot of a centreline may cover a part of the line.
    assert np.mean(away_px * mm_per_px <= spacing.max() + 2 * mm_per_px) > 0.97
    assert workstation.faults == []


def test_lumen_outline_is_hidden_and_shown_by_a_key_and_a_button(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    # In the middle of the route the slice cuts the airways over a long distance, at the root over a few millimetres
    # only.
    workstation.go_to(0.5 * workstation.state("route.length_mm"))
    workstation.page.mouse.move(5, 300)
    workstation.wait_for(f"({OUTLINE_PIXELS})('coronal').pixels.length > 50")
    workstation.page.keyboard.press("Shift+O")
    workstation.wait_for("!window.__carina.state.ui.outlineVisible")
    workstation.wait_for(f"({OUTLINE_PIXELS})('coronal').pixels.length === 0")
    workstation.page.locator(".cell[data-cell=axial] [data-testid=outline]").click()
    workstation.wait_for(f"({OUTLINE_PIXELS})('coronal').pixels.length > 50")
    assert workstation.faults == []


def test_click_on_an_uncertain_airway_end_shows_it_in_the_airway_view_and_all_slices(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    workstation.page.locator("[data-testid=uncertain] summary").click()
    place = workstation.state("tree.uncertain[0]")
    workstation.page.locator("[data-testid=uncertain] button").first.click()
    workstation.wait_for("window.__carina.state.session.sight.crosshair_lps !== null")
    crosshair = workstation.state("session.sight.crosshair_lps")
    known = workstation.state("tree.uncertain.map((place) => place.lps)")
    assert min(np.linalg.norm(np.subtract(known, crosshair), axis=1)) < 1e-6, "the position is in the list"
    assert place is not None
    workstation.wait_still()
    pose = np.reshape(workstation.state("pose.lps_from_camera"), (4, 4))
    look = crosshair - pose[:3, 3]
    assert 1.0 < np.linalg.norm(look) < 13.0
    assert pose[:3, 2] @ look / np.linalg.norm(look) > 0.999, "the airway view looks at the point"
    for view in ("axial", "coronal", "sagittal"):
        workstation.wait_for(
            f"((h) => h.full && Math.hypot(h.lps_from_pixel[0], h.lps_from_pixel[4], h.lps_from_pixel[8])"
            f" * Math.min(h.width, h.height) < 41)(window.__carina.state.frames['{view}'])",
        )
        workstation.wait_picture(view)
        header = workstation.state(f"frames['{view}']")
        column, row, depth, _ = np.linalg.inv(np.reshape(header["lps_from_pixel"], (4, 4))) @ [*crosshair, 1.0]
        assert abs(depth) < 0.01, "the slice passes through it"
        assert abs(column / header["width"] - 0.5) < 0.02
        assert abs(row / header["height"] - 0.5) < 0.02
    workstation.picture("outline-place")
    assert workstation.faults == []
