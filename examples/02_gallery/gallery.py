"""Gallery: the airway view with each preset, at the places of a real airway that a bronchoscopist knows.

You should see a trachea, a sharp carina, a lobar opening, a segmental fork and a small airway; then the carina through
a round mask, without texture, in grey, with vessels behind the wall, and as the paper drew it; a radiograph from the
front and the airway straightened along the route; last a made vessel with a path by each of the paper's costs
(docs/gallery.md).
Run: ``python examples/02_gallery/gallery.py [FOLDER]`` (the bundled patient without a folder).
"""

from __future__ import annotations

import dataclasses
import itertools
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import carina
from carina.render import (
    AirwayView,
    DrrView,
    PathSpan,
    PathView,
    Picture,
    Renderer,
    SliceView,
    letter_edges,
    mark_path,
)
from carina.scopes import scope_preset

SIZE = {"width": 320, "height": 320}


def way(tree: carina.AirwayTree) -> tuple[carina.FlightPath, list[PathSpan]]:
    """Return the path to the farthest branch, and the branches along it."""
    farthest = max(tree.tips(), key=lambda branch: (branch.generation, branch.id))
    spans, at_mm = [], 0.0
    for branch in tree.lineage(farthest.id):
        name = branch.name or f"generation {branch.generation}"
        spans.append(PathSpan(name, at_mm, at_mm + branch.length_mm))
        at_mm += branch.length_mm
    return carina.FlightPath(tree.route_to(farthest.id)), spans


def places(path: carina.FlightPath, spans: list[PathSpan]) -> dict[str, carina.Pose]:
    """Return camera poses along the path: in the trachea, before its end, before and in later forks."""
    ends = [span.to_mm for span in spans]
    return {
        "trachea": path.pose_at(0.25 * ends[0]),
        "carina": path.pose_at(ends[0] - 18.0),
        "main-bronchus": path.pose_at(ends[0] + 0.6 * (ends[1] - ends[0])),
        "lobar-fork": path.pose_at(ends[2] - 6.0),
        "segmental-fork": path.pose_at(ends[3] - 5.0),
        # In slices of 3 mm the walls of later ones are blurred.
        "small-airway": path.pose_at(ends[7] - 3.0),
    }


def phantom_with_tree() -> tuple[Renderer, carina.AirwayTree]:
    """Return a generated chest with a narrowed left main or intermediate bronchus, and its true airways."""
    box = ((-95.0, -60.0, -110.0), (95.0, 70.0, 115.0))
    phantom = carina.generate_phantom(spacing_mm=0.9, generations=4, stenosis=True, box_lps=box)
    tree = carina.AirwayTree.from_json(phantom.truth)
    renderer = Renderer(phantom.volume)
    renderer.set_lumen(phantom.lumen_zyx, tree)
    return renderer, tree


def decorated_places(tree: carina.AirwayTree) -> dict[str, carina.Pose]:
    """Return camera poses in the phantom: trachea, carina, main bronchus, lobar fork, before the narrow place."""
    found = {}
    for name, branch, from_mm, of in (
        ("decorated-trachea", "RMB", -72.0, 0),
        ("decorated-carina", "RMB", -11.0, 0),
        ("decorated-main-bronchus", "RMB", 8.0, 0),
        ("decorated-lobar", "RUL", -9.0, -1),
    ):
        lineage = tree.lineage(next(b.id for b in tree.branches if b.name == branch))
        ends = np.cumsum([b.length_mm for b in lineage])
        found[name] = carina.FlightPath(tree.route_to(lineage[-1].id)).pose_at(float(ends[of]) + from_mm)
    return found


def before_the_narrow_place(tree: carina.AirwayTree) -> carina.Pose:
    """Return a pose 14 mm before the narrowest point of the narrowed bronchus."""
    branch = next(b for b in tree.branches if b.name in {"LMB", "BI"} and b.radius.min() < 0.6 * np.median(b.radius))
    lineage = tree.lineage(branch.id)
    begins = sum(b.length_mm for b in lineage[:-1])
    steps = np.linalg.norm(np.diff(branch.points, axis=0), axis=1)
    at = begins + float(steps[: int(np.argmin(branch.radius))].sum())
    return carina.FlightPath(tree.route_to(branch.id)).pose_at(at - 14.0)


def bent_vessel() -> tuple[carina.Volume, list[NDArray[np.float64]]]:
    """Return a volume with a bright bent vessel in noisy tissue, as in MR, and the vessel's two ends in LPS mm."""
    k, j, i = np.indices((16, 96, 96))
    along = (np.hypot(i - 24.0, k - 8.0) < 5.0) & (j > 10) & (j < 78)
    across = (np.hypot(j - 72.0, k - 8.0) < 5.0) & (i > 19) & (i < 86)
    noise = np.random.default_rng(1).normal(0.0, 15.0, along.shape)
    values = np.where(along | across, 1200, 300) + noise
    volume = carina.Volume(np.ascontiguousarray(values, dtype=np.int16), np.diag([0.5, 0.5, 1.0, 1.0]))
    first, last = volume.to_lps(np.array([[24.0, 14.0, 8.0], [82.0, 72.0, 8.0]]))
    return volume, [first, last]


def with_line(picture: Picture, points_lps: NDArray[np.float64]) -> Picture:
    """Return a copy of a picture with a path drawn over it."""
    rgb = picture.rgb.copy()
    ends = [at for at in map(picture.pixel_of, points_lps) if at is not None]
    for (column, row), (to_column, to_row) in itertools.pairwise(ends):
        for part in np.linspace(0.0, 1.0, 12):
            i, j = int(column + part * (to_column - column)), int(row + part * (to_row - row))
            rgb[max(j - 1, 0) : j + 2, max(i - 1, 0) : i + 2] = (20, 140, 170)
    return dataclasses.replace(picture, rgb=rgb)


def main(case: str | None, out: Path) -> list[Path]:
    """Save the pictures and return their paths."""
    volume = carina.open_volume(case) if case else carina.demo_patient()
    airways = carina.find_airways(volume)
    path, spans = way(airways.tree)
    poses = places(path, spans)
    renderer = Renderer(volume)
    renderer.set_lumen(airways.lumen_zyx, airways.tree)
    saved = []

    def save(name: str, picture: Picture) -> None:
        saved.append(picture.save(out / f"{name}.png"))

    for name, pose in poses.items():
        save(name, renderer.render(AirwayView(pose, fov_deg=100.0, **SIZE)))
    fork = poses["carina"]
    save("carina-scope", renderer.render(AirwayView.of_scope(scope_preset("generic"), fork, **SIZE)))
    save("carina-no-texture", renderer.render(AirwayView(fork, fov_deg=100.0, texture=False, **SIZE)))
    for preset in ("ct-grey", "see-through", "paper"):
        renderer.set_transfer(carina.transfer_preset(preset))
        save(f"carina-{preset}", renderer.render(AirwayView(fork, fov_deg=100.0, **SIZE)))
    made, tree = phantom_with_tree()
    scope = scope_preset("generic")
    for name, pose in {**decorated_places(tree), "decorated-narrow": before_the_narrow_place(tree)}.items():
        save(name, made.render(AirwayView.of_scope(scope, pose, **SIZE)))
    carina_pose = decorated_places(tree)["decorated-carina"]
    save("decorated-off", made.render(AirwayView.of_scope(scope, carina_pose, texture=False, **SIZE)))
    save("radiograph", letter_edges(renderer.render(DrrView(**SIZE))))
    straight = renderer.render(PathView("straightened", path.frames(), width=320, height=480))
    save("straightened", letter_edges(mark_path(straight, spans=spans)))
    vessel, (root, target) = bent_vessel()
    middle = (float(root[0] + target[0]) / 2.0, float(root[1] + target[1]) / 2.0, float(root[2]))
    plane = Renderer(vessel).render(SliceView("axial", middle, window_hu=(1500.0, 700.0), **SIZE))
    for cost in ("walls", "paper"):
        found = carina.track_paths(vessel, root=root, targets=[target], cost=cost, progress=False).targets[0].path
        assert found is not None
        save(f"vessel-{cost}", letter_edges(with_line(plane, found.points_lps)))
    return saved


if __name__ == "__main__":
    for file in main(sys.argv[1] if len(sys.argv) > 1 else None, Path.cwd()):
        print(file)
