"""The turns to a nodule: plan a route, print it fork by fork, save a picture of each fork.

You should read a line for each fork (where, what, at which hour), and find a picture of each with the right opening
outlined.
Run: ``python examples/05_turns/turns.py`` (the bundled phantom with its nodule).
"""

from __future__ import annotations

from pathlib import Path

import carina
from carina.plan import plan_route, turn_list, turn_pictures


def main(out: Path) -> list[Path]:
    """Save a picture of each turn and return their paths."""
    made = carina.generate_phantom(seed=4, spacing_mm=1.2, generations=5, nodule=True)
    airways = carina.find_airways(made.volume)
    route = plan_route(made.volume, airways, made.truth["nodule"]["centre_lps"]).routes[0]

    # The hours are measured in the pictures of the CT, so the list and the pictures use one renderer.
    renderer = carina.Renderer(made.volume)
    renderer.set_lumen(airways.lumen_zyx)
    turns = turn_list(
        airways.tree,
        route,
        renderer=renderer,
        carina_depth_mm=265.0,  # read on the scope when its tip is at the carina
    )
    print("\n".join(turns.words("head")))

    saved = []
    for number, picture in enumerate(turn_pictures(made.volume, airways, turns, renderer=renderer), start=1):
        path = out / f"turn-{number}.png"
        path.write_bytes(picture.png())
        saved.append(path)
    return saved


if __name__ == "__main__":
    for file in main(Path.cwd()):
        print(file)
