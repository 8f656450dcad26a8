"""``python -m carina_bench.plan_nodule_volumes``: volumes of nodules segmented from one click, beside exact shapes.

The exact shapes are of two kinds: pieces of lung painted from shapes (``tests/plan/painted_nodules.py``: random blur,
noise, slices, vessels and chest wall), and the nodules of whole phantoms, whose vessels and airways are arranged as in
a lung. *Held* is the share of stated intervals that contain the true volume; the intervals are intended to hold 90 %.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from itertools import chain
from pathlib import Path

import numpy as np

from carina.errors import NoResultError
from carina.phantom import generate_phantom
from carina.plan import grow_nodule
from carina.volume import Volume

__all__ = ["Figures", "painted_figures", "phantom_figures"]

PAINTED = ("solid", "vessel", "pleura", "ground-glass", "part-solid", "2 mm", "3 mm")
"""Kinds of nodules that are painted from exact shapes."""
LIMITS = {"solid": 0.05, "phantom, no vessel": 0.05}
"""Maximum relative error of a nodule's volume, by kind of nodule."""
OTHER_LIMIT = 0.15
"""Maximum relative error of the volume for a kind that `LIMITS` does not list."""
SCENES, QUICK_SCENES = 24, 4
"""Number of painted nodules of each kind, in a full and in a quick run."""
FIRST_SCENE = 1000
"""Seed of the first painted nodule; the following nodules have the following seeds."""
PHANTOMS, QUICK_PHANTOMS = range(30), range(4)
"""Seeds of the phantoms with nodules, in a full and in a quick run."""
SPACING_MM, NOISE_HU, HALF_MM, THICK = 0.8, 25.0, 40.0, 3
"""Spacing (mm) and noise (HU) of the phantoms, half side of the box around a nodule (mm), slices per thick slice."""


@dataclass(frozen=True, slots=True)
class Figures:
    """Results of nodules of one kind; errors are shares of the true volume."""

    kind: str
    num: int
    refused: int
    limit: float
    within: float
    """Share of the nodules whose volume has an error of at most ``limit``."""
    median_off: float
    p90_off: float
    worst_off: float
    stated: float
    """Median half-width of the stated interval of the volume, as a share of the volume."""
    held: float
    seconds: float
    """Median time from a click to the segmented nodule, s."""


class _Tally:
    def __init__(self, kind: str) -> None:
        self.kind = kind
        self.off: list[float] = []
        self.stated: list[float] = []
        self.seconds: list[float] = []
        self.refused = 0

    def click(self, volume: Volume, at: np.ndarray, true_mm3: float) -> tuple[str, ...]:
        began = time.process_time()
        try:
            nodule = grow_nodule(volume, at)
        except NoResultError:
            self.refused += 1
            return ()
        self.seconds.append(time.process_time() - began)
        self.off.append(nodule.volume_mm3 / true_mm3 - 1.0)
        self.stated.append(nodule.volume_error_mm3 / true_mm3)
        return nodule.touches

    def figures(self) -> Figures:
        off, stated = np.abs(self.off), np.array(self.stated)
        limit = LIMITS.get(self.kind, OTHER_LIMIT)
        num = len(off) + self.refused
        return Figures(
            kind=self.kind,
            num=num,
            refused=self.refused,
            limit=limit,
            # A nodule that was refused has no volume, so it does not count as within the limit.
            within=float((off <= limit).sum()) / max(num, 1),
            median_off=float(np.median(off)) if off.size else float("nan"),
            p90_off=float(np.percentile(off, 90.0)) if off.size else float("nan"),
            worst_off=float(off.max()) if off.size else float("nan"),
            stated=float(np.median(stated)) if off.size else float("nan"),
            held=float((off <= stated).mean()) if off.size else float("nan"),
            seconds=float(np.median(self.seconds)) if self.seconds else float("nan"),
        )


def painted_figures(num: int, say: Callable[[str], None]) -> Iterator[Figures]:
    """Yield the results of each kind of painted nodules, ``num`` nodules of each; clicks are beside the centre."""
    folder = Path(__file__).resolve().parents[2] / "tests" / "plan"
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))
    from painted_nodules import painted, random_scene  # type: ignore[import-untyped, import-not-found, unused-ignore]

    for kind in PAINTED:
        say(f"painted: {kind}")
        tally = _Tally(kind)
        for seed in range(FIRST_SCENE, FIRST_SCENE + num):
            rng = np.random.default_rng([seed, *kind.encode()])
            scene = random_scene(kind, rng)
            volume, true_mm3, middle = painted(scene)
            aside = rng.uniform(-0.3, 0.3, 3) * min(scene.radii_mm)
            if kind == "pleura":
                aside = np.array([-0.3 * scene.radii_mm[0], 0.0, 0.0])
            tally.click(volume, middle + aside, true_mm3)
        yield tally.figures()


def phantom_figures(seeds: range, say: Callable[[str], None]) -> Iterator[Figures]:
    """Yield the results of phantoms' nodules in slices of 0.8 and 2.4 mm, separately for those that touch a vessel."""
    free, touched, thick = _Tally("phantom, no vessel"), _Tally("phantom, vessel"), _Tally("phantom, 2.4 mm")
    for seed in seeds:
        say(f"phantom {seed}")
        tiny = generate_phantom(seed=seed, spacing_mm=5.0, nodule=True, box_lps=((0, 0, 0), (12, 12, 12)))
        middle, radius = np.array(tiny.truth["nodule"]["centre_lps"]), float(tiny.truth["nodule"]["radius_mm"])
        low, high = middle - HALF_MM, middle + HALF_MM
        box = ((low[0], low[1], low[2]), (high[0], high[1], high[2]))
        volume = generate_phantom(seed=seed, spacing_mm=SPACING_MM, nodule=True, noise_hu=NOISE_HU, box_lps=box).volume
        true_mm3 = 4.0 / 3.0 * np.pi * radius**3
        at = middle + np.array([0.3, -0.2, 0.0]) * radius
        tally = _Tally("")
        touches = tally.click(volume, at, true_mm3)
        own = touched if "vessel" in touches else free
        own.off += tally.off
        own.stated += tally.stated
        own.seconds += tally.seconds
        own.refused += tally.refused
        thick.click(_thicker(volume), at, true_mm3)
    for tally in (free, touched, thick):
        yield tally.figures()


def _thicker(volume: Volume) -> Volume:
    """Return the CT with slices that are means of three slices each."""
    num = volume.shape_zyx[0] // THICK
    values = volume.hu_zyx[: num * THICK].reshape(num, THICK, *volume.shape_zyx[1:]).mean(axis=1)
    matrix = volume.lps_from_ijk.copy()
    matrix[:3, 3] += matrix[:3, 2] * (THICK - 1) / 2.0
    matrix[:3, 2] *= THICK
    return Volume(np.rint(values).astype(np.int16), matrix)


def main() -> None:
    """Run the command line: print a line for each kind, and write the results as JSON if requested."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a few of each")
    parser.add_argument("--json", type=Path, help="write the figures there")
    options = parser.parse_args()

    def say(words: str) -> None:
        print(words, file=sys.stderr, flush=True)

    rows = []
    print("kind                  num  within limit     median    p90  worst stated  held")
    for figures in chain(
        painted_figures(QUICK_SCENES if options.quick else SCENES, say),
        phantom_figures(QUICK_PHANTOMS if options.quick else PHANTOMS, say),
    ):
        rows.append(asdict(figures))
        print(
            f"{figures.kind:20s} {figures.num:4d} {figures.within:7.2f} of {100 * figures.limit:2.0f} % "
            f"{100 * figures.median_off:6.1f}% {100 * figures.p90_off:5.1f}% {100 * figures.worst_off:5.1f}% "
            f"{100 * figures.stated:5.1f}% {figures.held:5.2f}  refused {figures.refused}, {figures.seconds:.2f} s",
            flush=True,
        )
    if options.json is not None:
        options.json.write_text(json.dumps(rows, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
