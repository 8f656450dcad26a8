"""Positions of anatomy on the page, in page coordinates (CSS px), and waits for the pictures that show it."""

from __future__ import annotations

import numpy as np

PREVIEWED = """() => {
    const { preview } = window.__carina.state;
    return preview !== null && !preview.stale && preview.answer?.problem === null;
}"""


def place_on_tree(workstation, branch_id, part=0.5):
    """Return the position of a point of a branch in the external view of the tree, in page coordinates."""
    return workstation.page.evaluate(
        """([id, part]) => {
            const state = window.__carina.state;
            const { points } = state.tree.byId.get(id).branch;
            const p = points[Math.round(part * (points.length - 1))];
            const { lps_from_camera: m, fov_deg, width, height } = state.frames.tree;
            const d = [p[0] - m[3], p[1] - m[7], p[2] - m[11]];
            const along = (c) => d[0] * m[c] + d[1] * m[4 + c] + d[2] * m[8 + c];
            const focal = (0.5 * Math.min(width, height)) / Math.tan((fov_deg * Math.PI) / 360);
            const column = width / 2 + (focal * along(0)) / along(2);
            const row = height / 2 + (focal * along(1)) / along(2);
            const box = document.querySelector('canvas[data-view=tree]').getBoundingClientRect();
            return [box.x + (column / width) * box.width, box.y + (row / height) * box.height];
        }""",
        [branch_id, part],
    )


def named(workstation, name):
    """Return the ID of the branch ``name``."""
    return workstation.page.evaluate(
        "(name) => [...window.__carina.state.tree.byId.values()].find((n) => n.branch.name === name).branch.id", name
    )


def show_slices_at(workstation, lps):
    """Type a point as the position of the crosshair, and wait until the slices show the point."""
    workstation.page.keyboard.press("n")
    workstation.page.keyboard.press("Escape")
    field = workstation.page.locator("[data-testid=coordinates] input")
    field.fill(", ".join(f"{v:.3f}" for v in lps))
    workstation.page.locator(".coordinates").get_by_role("button", name="Show").click()
    # Each slice is a separate picture and arrives alone.
    workstation.wait_for(
        """(lps) => [['sagittal', 0], ['coronal', 1], ['axial', 2]].every(([view, axis]) => {
            const shown = [...document.querySelectorAll('canvas[data-view]')]
                .some((canvas) => canvas.dataset.view === view && canvas.offsetParent !== null);
            const m = window.__carina.state.frames[view]?.lps_from_pixel;
            return !shown || (m !== undefined && Math.abs(m[4 * axis + 3] - lps[axis]) < 0.1);
        })""",
        lps,
    )
    field.fill("")
    workstation.page.evaluate("() => document.activeElement.blur()")


def place_in_slice(workstation, view, lps):
    """Return the position of a point in a slice, in page coordinates, when the slice has the shape of its cell."""
    # A step of the work can change the layout; the picture of the earlier layout stays until the next one arrives.
    workstation.wait_for(
        """(view) => {
            const { width, height } = window.__carina.state.frames[view];
            const box = document.querySelector(`canvas[data-view=${view}]`).getBoundingClientRect();
            return Math.abs(width / height - box.width / box.height) < 0.02;
        }""",
        view,
    )
    return workstation.page.evaluate(
        """([view, lps]) => {
            const { lps_from_pixel: m, width, height } = window.__carina.state.frames[view];
            const d = lps.map((v, i) => v - m[4 * i + 3]);
            const along = (c) => {
                const axis = [m[c], m[4 + c], m[8 + c]];
                return axis.reduce((sum, v, i) => sum + v * d[i], 0) / axis.reduce((sum, v) => sum + v * v, 0);
            };
            const box = document.querySelector(`canvas[data-view=${view}]`).getBoundingClientRect();
            return [box.x + (along(0) / width) * box.width, box.y + (along(1) / height) * box.height];
        }""",
        [view, lps],
    )


def place_in_tri_plane(workstation, lps):
    """Return the position of a point in the tri-plane view, in page coordinates."""
    return workstation.page.evaluate(
        """(p) => {
            const { lps_from_camera: m, fov_deg, width, height } = window.__carina.state.frames['tri-plane'];
            const d = [p[0] - m[3], p[1] - m[7], p[2] - m[11]];
            const along = (c) => d[0] * m[c] + d[1] * m[4 + c] + d[2] * m[8 + c];
            const focal = (0.5 * Math.min(width, height)) / Math.tan((fov_deg * Math.PI) / 360);
            const box = document.querySelector('canvas[data-view=tri-plane]').getBoundingClientRect();
            return [box.x + ((width / 2 + (focal * along(0)) / along(2)) / width) * box.width,
                    box.y + ((height / 2 + (focal * along(1)) / along(2)) / height) * box.height];
        }""",
        lps,
    )


def tree_is_shown(workstation):
    """Wait for the final picture of the external view of the tree."""
    workstation.wait_for("() => document.querySelector('canvas[data-view=tree]')?.dataset.full === 'true'")


def all_points(workstation):
    """Return the points of all branches of the tree on the page, as text that tests compare."""
    points = workstation.page.evaluate(
        "() => [...window.__carina.state.tree.byId.values()].flatMap((node) => node.branch.points)"
    )
    return {str(p) for p in points}


def extent_mm(workstation, view):
    """Return the width of the picture that a view shows, in mm."""
    header = workstation.state(f"frames['{view}']")
    matrix = np.reshape(header["lps_from_pixel"], (4, 4))
    return float(np.linalg.norm(matrix[:3, 0])) * header["width"]


def middle_lps(workstation, view):
    """Return the LPS point in the middle of the picture that a view shows."""
    header = workstation.state(f"frames['{view}']")
    matrix = np.reshape(header["lps_from_pixel"], (4, 4))
    return (matrix @ (header["width"] / 2, header["height"] / 2, 0.0, 1.0))[:3]


def host(workstation, view):
    """Return the rectangle of a view in which clicks count, in CSS px."""
    return workstation.page.locator(f".picture-host:has(canvas[data-view={view}])").bounding_box()


def drag(workstation, view, start, end, button="left"):
    """Drag from ``start`` to ``end`` in a view; both are fractions of its width and height."""
    box, mouse = host(workstation, view), workstation.page.mouse
    mouse.move(box["x"] + start[0] * box["width"], box["y"] + start[1] * box["height"])
    mouse.down(button=button)
    mouse.move(box["x"] + end[0] * box["width"], box["y"] + end[1] * box["height"], steps=6)
    mouse.up(button=button)
