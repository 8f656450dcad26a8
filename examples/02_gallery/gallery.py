"""Gallery: the airway view with each preset, at the places of a real airway that a bronchoscopist knows.

You should see a trachea, a sharp carina, a lobar opening, a segmental fork and a small airway; then the carina through
a round mask, without texture, in grey, with vessels behind the wall, and as the paper drew it; last a radiograph from
the front and the airway straightened along the route (docs/gallery.md).
Run: ``python examples/02_gallery/gallery.py [FOLDER]`` (the bundled patient without a folder).
"""

from __future__ import annotations

import sys
from pathlib import Path

import carina
from carina.render import AirwayView, DrrView, PathSpan, PathView, Picture, Renderer, letter_edges, mark_path
from carina.scopes import scope_preset

SIZE = {"width": 320, "height": 320}


def way(tree: carina.AirwayTree) -> tuple[carina.FlightPath, list[PathSpan]]:
    """The path to the farthest branch, and the branches along it."""
    farthest = max(tree.tips(), key=lambda branch: (branch.generation, branch.id))
    spans, at_mm = [], 0.0
    for branch in tree.lineage(farthest.id):
        name = branch.name or f"generation {branch.generation}"
        spans.append(PathSpan(name, at_mm, at_mm + branch.length_mm))
        at_mm += branch.length_mm
    return carina.FlightPath(tree.route_to(farthest.id).points_lps), spans


def places(path: carina.FlightPath, spans: list[PathSpan]) -> dict[str, carina.Pose]:
    """Camera poses along the path: in the trachea, before its end, before and in later forks."""
    ends = [span.to_mm for span in spans]
    return {
        "trachea": path.pose_at(0.25 * ends[0]),
        "carina": path.pose_at(ends[0] - 18.0),
        "main-bronchus": path.pose_at(ends[0] + 0.6 * (ends[1] - ends[0])),
        "lobar-fork": path.pose_at(ends[2] - 6.0),
        "segmental-fork": path.pose_at(ends[3] - 5.0),
        "small-airway": path.pose_at(ends[-2]),
    }


def main(case: str | None, out: Path) -> list[Path]:
    """Save the pictures and return their paths."""
    volume = carina.open_volume(case) if case else carina.demo_patient()
    airways = carina.find_airways(volume)
    path, spans = way(airways.tree)
    poses = places(path, spans)
    renderer = Renderer(volume)
    renderer.set_lumen(airways.lumen_zyx)
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
    save("radiograph", letter_edges(renderer.render(DrrView(**SIZE))))
    straight = renderer.render(PathView("straightened", path.frames(), width=320, height=480))
    save("straightened", letter_edges(mark_path(straight, spans=spans)))
    return saved


if __name__ == "__main__":
    for file in main(sys.argv[1] if len(sys.argv) > 1 else None, Path.cwd()):
        print(file)
