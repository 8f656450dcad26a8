"""Blind test of the drawn airway surface: readers state the clock position of the back wall in rotated pictures.

``python -m carina_bench.blind_reading draw FOLDER CASE ...`` writes pictures, half of them without decoration, and
their answers in ``key.json``, which readers must not see. A reader writes hours into a file, ``{"00": 4.5, ...}``: 12
for the top of the picture. ``python -m carina_bench.blind_reading score FOLDER/key.json HOURS.json`` prints the errors.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import carina
from carina.errors import UsageError
from carina.navigate import FlightPath
from carina.render import AirwayView, Renderer
from carina.scopes import Pose, scope_preset
from carina_bench import pictures

__all__ = ["back_hour", "draw", "scores", "turned"]

BEFORE_CARINA_MM = (70.0, 50.0, 32.0)
"""Distances of the drawn viewpoints above the carina, along the path, mm."""
TO_THE_BACK_LPS = (0.0, 1.0, 0.0)
"""Unit vector from the patient's front to the back, LPS."""
SIZE = 512
"""Width and height in pixels of the pictures that readers judge without information on their origin."""


def turned(pose: Pose, roll_rad: float) -> Pose:
    """Return the pose rolled by ``roll_rad`` about the axis of view."""
    c, s = math.cos(roll_rad), math.sin(roll_rad)
    matrix = pose.lps_from_camera.copy()
    matrix[:3, :3] = matrix[:3, :3] @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return Pose(matrix)


def back_hour(pose: Pose) -> float:
    """Return the clock position of the patient's back in the picture: 0 to 12, where 0 is the top and 3 the right."""
    right, down, _ = pose.lps_from_camera[:3, :3].T @ np.array(TO_THE_BACK_LPS)
    return float(np.degrees(np.arctan2(right, -down)) / 30.0 % 12.0)


def draw(folder: Path, cases: Sequence[str], seed: int | None = None) -> int:
    """Write pictures for each case and viewpoint, and their answers in ``key.json``; return the number of pictures."""
    rng = np.random.default_rng(seed)
    shown: list[tuple[Renderer, str, float, Pose, bool]] = []
    for case in cases:
        volume = carina.demo_patient() if case == "patient" else carina.open_volume(Path(case))
        airways = carina.find_airways(volume)
        renderer = Renderer(volume)
        renderer.set_lumen(airways.lumen_zyx, airways.tree)
        tip = max(airways.tree.tips(), key=lambda branch: (branch.generation, branch.id))
        trachea_mm = sum(b.length_mm for b in airways.tree.lineage(tip.id) if b.name == "Trachea")
        path = FlightPath(airways.tree.route_to(tip.id))
        for before_mm in BEFORE_CARINA_MM:
            if trachea_mm - before_mm > 3.0:
                pose = path.pose_at(trachea_mm - before_mm)
                shown += [(renderer, case, before_mm, pose, decorated) for decorated in (True, False)]
    if not shown:
        raise UsageError("none of the cases has a trachea of 35 mm or more; other cases are needed")
    folder.mkdir(parents=True, exist_ok=True)
    key: dict[str, dict[str, Any]] = {}
    for n, at in enumerate(rng.permutation(len(shown))):
        renderer, case, before_mm, pose, decorated = shown[at]
        pose = turned(pose, rng.uniform(0.0, 2.0 * np.pi))
        scope = scope_preset("generic")
        view = AirwayView.of_scope(scope, pose, width=SIZE, height=SIZE, texture=decorated)
        # Only the pixels are saved, because a saved `Picture` would contain its pose and so the answer.
        pictures.save(folder, f"{n:02d}", renderer.render(view).rgb)
        key[f"{n:02d}"] = {
            "case": case,
            "before_carina_mm": before_mm,
            "decorated": decorated,
            "hour": round(back_hour(pose), 2),
        }
    (folder / "key.json").write_text(json.dumps(key, indent=1), encoding="utf-8")
    return len(key)


def scores(key: Mapping[str, Mapping[str, Any]], answers: Mapping[str, float]) -> dict[str, dict[str, float]]:
    """Return the errors of a reader's clock positions, once for pictures with decoration and once for those without.

    Raises
    ------
    UsageError
        If the reader gave no answer for a picture.
    """
    missing = sorted(set(key) - set(answers))
    if missing:
        raise UsageError(f"no hour is stated for picture {', '.join(missing)}")
    rows = {}
    for name, decorated in (("decorated", True), ("plain", False)):
        off: NDArray[np.float64] = np.array(
            [
                abs((answers[picture] - answer["hour"] + 6.0) % 12.0 - 6.0)
                for picture, answer in key.items()
                if answer["decorated"] == decorated
            ]
        )
        if off.size:
            rows[name] = {
                "pictures": off.size,
                "median_h": round(float(np.median(off)), 2),
                "worst_h": round(float(off.max()), 2),
                "within_1_h": int((off <= 1.0).sum()),
            }
    return rows


def main(argv: Sequence[str] | None = None) -> None:
    """Run the command line: write the pictures (``draw``), or print a reader's errors (``score``)."""
    parser = argparse.ArgumentParser(prog="python -m carina_bench.blind_reading", description=__doc__)
    kinds = parser.add_subparsers(dest="kind", required=True)
    drawn = kinds.add_parser("draw")
    drawn.add_argument("folder", type=Path)
    drawn.add_argument("cases", nargs="+", help="patient (the bundled case), or paths of CTs")
    drawn.add_argument("--seed", type=int)
    score = kinds.add_parser("score")
    score.add_argument("key", type=Path)
    score.add_argument("hours", type=Path)
    args = parser.parse_args(argv)
    if args.kind == "draw":
        print(f"{draw(args.folder, args.cases, args.seed)} pictures in {args.folder}")
        return
    key, answers = (json.loads(file.read_text(encoding="utf-8")) for file in (args.key, args.hours))
    print(json.dumps(scores(key, answers)))


if __name__ == "__main__":
    main()
