"""First airway: open a case, find the airways, fly to a bronchus, save what the scope sees.

You should see the inside of the trachea with the carina ahead, then the inside of a smaller bronchus.
Run: ``python examples/01_first_airway/first_airway.py [FOLDER]`` (the bundled phantom without a folder).
"""

from __future__ import annotations

import sys
from pathlib import Path

import carina
from carina.phantom import demo_phantom


def main(case: str | None, out: Path) -> list[Path]:
    """Save two pictures and return their paths."""
    volume = carina.open_volume(case) if case else demo_phantom().volume
    airways = carina.find_airways(volume)
    print(f"{len(airways.tree.branches)} branches from {airways.root_lps.round(1)} mm")

    farthest = max(airways.tree.tips(), key=lambda branch: branch.generation)
    path = carina.FlightPath(airways.tree.route_to(farthest.id))
    saved = []
    for name, at_mm in (("trachea", 0.25 * path.length_mm), ("bronchus", 0.8 * path.length_mm)):
        picture = carina.render_view(
            volume, view="airway", pose=path.pose_at(at_mm), width=512, height=512, lumen_zyx=airways.lumen_zyx
        )
        saved.append(picture.save(out / f"{name}.png"))
    return saved


if __name__ == "__main__":
    for file in main(sys.argv[1] if len(sys.argv) > 1 else None, Path.cwd()):
        print(file)
