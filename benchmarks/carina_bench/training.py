"""``python -m carina_bench.training``: ranking of five classes of scripted drivers by the scores of training.

Each class flies once on each case (phantoms by seed, and the bundled CT); the seed of a flight is that of the case. A
score ranks two classes with the probability that the better class has the better value, over all pairs of their
flights; equal values count half. ``GAPS`` names the pairs that the literature separates by each score, and its source
(`docs/training.md`); other pairs are printed and not judged. The independent scorer of the tests scores the recordings
of the first ten cases, 50 in all. ``--json FILE`` stores each case when it is finished; the same command then continues
after the last stored case. ``--first`` selects another part of the cases, so that several processes share them;
``--summarise FILE ...`` prints the ranking of their files.

The drivers are scripts, not people: their speeds, pauses and mistakes are assumptions of this file. Speeds, holds,
waits and the order of the segments of the novice and the experienced driver were calibrated on phantoms 20 to 29,
which are not ranked, to the medians of the novices and of the experienced people in the BronchoBot study (Cold 2025),
and not to a probability. The study was read only in an excerpt with these medians, so the spread between flights of a
class is an assumption, on which each probability depends. The optimal driver is not calibrated, because it must reach
mastery in less than 120 s. The output prints the medians beside the published ones.
"""

from __future__ import annotations

import argparse
import io
import json
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

import carina
from carina.disk import write_whole
from carina.navigate.recording import read_recording
from carina.phantom import generate_phantom
from carina.scopes import WallField
from carina.track import AirwayTree
from carina.training import REFERENCE_GROUPS, SEGMENTS, Score, find_task, flight_frames, score_flight, segments_of_case
from carina.training.openings_in_sight import branch_openings, openings_in_sight
from carina.volume import Volume

__all__ = ["CLASSES", "GAPS", "TrainingCase", "cases", "flown", "probability"]

SPACING_MM, NOISE_HU, WALL_MM = 1.1, 25.0, 0.6
"""Spacing and noise of the phantoms, and spacing of the field of distances to the wall."""
LEAST_PROBABILITY = 0.99
MAX_OPTIMAL_S = 120.0
COMPARED = {"clock-start", "seen", "visit", "revisit", "progress", "contact", "clock-end"}
"""Kinds of events in which both scorers must agree."""
LOBES = (("RB1", "RB2", "RB3"), ("RB4", "RB5"), ("RB6", "RB7", "RB8", "RB9", "RB10"), ("LB1+2", "LB3"), ("LB4", "LB5"),
         ("LB6", "LB8", "LB9", "LB10"))  # fmt: skip
"""Segments of each lobe; the lingula counts as one."""
Gap = tuple[str, str]


@dataclass(frozen=True, slots=True)
class _Measure:
    """One value of a score, its direction, and the pairs of classes that it separates by the literature."""

    name: str
    more_is_better: bool
    gaps: tuple[Gap, ...]
    """Pairs of flights of which the first must have the better score."""
    source: str


_NOVICES = (("optimal", "experienced"), ("experienced", "novice"), ("optimal", "novice"), ("optimal", "random"))
PUBLISHED_AS = {"novice": "novices (10)", "experienced": "experienced (10)", "optimal": "autonomous robot"}
"""Published group of each driver whose medians are printed beside those of the group."""
MEDIANS = (("diagnostic_completeness", "DC", 1), ("structured_progress", "SP", 1), ("procedure_time_s", "PT s", 0),
           ("mean_intersegmental_time_s", "MIT s", 1))  # fmt: skip
"""Published scores, with their short names and the decimals of their medians."""
GAPS: tuple[_Measure, ...] = (
    _Measure(
        "diagnostic_completeness", True, (*_NOVICES[1:], ("experienced", "random")), "BronchoBot study, Cold 2025"
    ),
    _Measure("structured_progress", True, (*_NOVICES, ("experienced", "random")), "BronchoBot study, Cold 2025"),
    _Measure("procedure_time_s", False, _NOVICES[:3], "BronchoBot study, Cold 2025"),
    _Measure("mean_intersegmental_time_s", False, _NOVICES[:3], "BronchoBot study, Cold 2025"),
    _Measure("segments_revisited", False, (("optimal", "novice"), ("experienced", "novice")), "Agbontaen 2025"),
    _Measure("num_contacts", False, (("optimal", "wall-hugging"), ("experienced", "wall-hugging")), "Moorthy 2003"),
    _Measure("path_mm_per_segment", False, (("optimal", "novice"),), "Moorthy 2003"),
    _Measure("lumen_in_middle", True, (("optimal", "novice"), ("experienced", "novice")), "Nature Communications 2023"),
)
NOT_JUDGED: tuple[tuple[str, Gap, str], ...] = (
    (
        "diagnostic_completeness",
        ("optimal", "experienced"),
        "medians 18 of a robot and 16 of experienced people in the BronchoBot study, whose test was not read; in two "
        "other studies completeness did not differ between trained groups (Cold 2024: 17.2 and 17.3; Agbontaen 2025)",
    ),
)
"""Pairs that are printed without a limit: score, pair (better, worse), and why the literature does not separate
them."""


def _scripts() -> Any:
    """Return the scripted flights and the independent scorer of the tests."""
    folder = Path(__file__).resolve().parents[2] / "tests" / "training"
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))
    import independent_scorer  # type: ignore[import-untyped, import-not-found, unused-ignore]
    import scripted_flights  # type: ignore[import-untyped, import-not-found, unused-ignore]

    return scripted_flights, independent_scorer


@dataclass(frozen=True, slots=True, eq=False)
class TrainingCase:
    """A case on which the drivers fly."""

    name: str
    seed: int
    volume: Volume
    tree: AirwayTree
    wall: WallField
    parts: dict[str, tuple[str, ...]]
    """Names of the branches of each segment of the case, in ascending order; several if its parts arise separately."""

    @property
    def segments(self) -> tuple[str, ...]:
        """Segments of the case, in ascending order."""
        return tuple(self.parts)


def cases(seeds: Iterable[int]) -> Iterator[TrainingCase]:
    """Yield the cases of seeds: the bundled CT for 0, else a phantom; airways are those that Carina finds."""
    for seed in seeds:
        if seed == 0:
            volume, name = carina.demo_patient(), "bundled CT"
        else:
            volume = generate_phantom(seed=seed, spacing_mm=SPACING_MM, noise_hu=NOISE_HU, progress=False).volume
            name = f"phantom {seed}"
        airways = carina.find_airways(volume, progress=False)
        wall = carina.wall_field(volume, airways, spacing_mm=WALL_MM, progress=False)
        parts = {
            one.name: tuple(str(airways.tree.branch(number).name) for number in one.branch_ids)
            for one in segments_of_case(airways.tree)
        }
        for script in _scripts():
            script.forget_cases()
        yield TrainingCase(name, seed, volume, airways.tree, wall, parts)


def _optimal(script: Any, case: TrainingCase, _rng: np.random.Generator) -> None:
    """Inspect all segments in ascending order at 60 mm/s, and hold each for 1.2 s.

    Where less than half of an opening is in the picture from before the fork, the driver enters the segment instead.
    """
    for name in case.segments:
        for part in case.parts[name]:
            before = len(script.poses)
            script.inspect(part)
            if not _held_in_sight(script.poses[before:], case, part):
                script.enter(part, depth_mm=3.0)


def _held_in_sight(poses: list[np.ndarray], case: TrainingCase, part: str) -> bool:
    """Return whether the opening of a branch is in sight, by the rules of the score, at the last pose."""
    scripts, _ = _scripts()
    (branch,) = [one for one in case.tree.branches if one.name == part][:1]
    frames = flight_frames(scripts.recording_of([poses[-1]] * 3, case.volume))
    openings = branch_openings(case.tree, [branch.id], case.wall)
    return bool(openings_in_sight(frames, openings, case.wall, first=0, last=0).in_sight[0, 0])


def _inspect(script: Any, case: TrainingCase, name: str, **options: float) -> None:
    """Inspect the openings of all parts of a segment."""
    for part in case.parts[name]:
        script.inspect(part, **options)


def _experienced(script: Any, case: TrainingCase, rng: np.random.Generator) -> None:
    """Inspect the segments lobe by lobe, the lobes in a random order, without the two of the middle lobe or lingula."""
    left_out = LOBES[1 if rng.random() < 0.5 else 4]
    lobes = [one for one in LOBES if one != left_out]
    for number in rng.permutation(len(lobes)):
        lobe = lobes[int(number)]
        for name in lobe if rng.random() < EXPERIENCED_ORDER else _shuffled(lobe, rng):
            if name in case.parts:
                _inspect(script, case, name)


def _shuffled(names: Sequence[str], rng: np.random.Generator) -> list[str]:
    """Return names in a random order."""
    return [names[int(number)] for number in rng.permutation(len(names))]


EXPERIENCED_ORDER = 0.5
"""Probability that the experienced driver inspects the segments of a lobe in ascending order."""
NOVICE_WAITS_S = 8.0, 26.0
"""Shortest and longest wait of the novice in a segment, s."""


def _novice(script: Any, case: TrainingCase, rng: np.random.Generator) -> None:
    """Enter the segments of half of the lobes, lobe by lobe, with an unsteady view, and return to two or three."""
    lobes = [LOBES[int(number)] for number in rng.permutation(len(LOBES))[: len(LOBES) // 2]]
    order = [name for lobe in lobes for name in _shuffled(lobe, rng) if name in case.parts]
    for name in (*order, *_shuffled(order, rng)[: int(rng.integers(2, 4))]):
        script.enter(case.parts[name][0])
        script.wait(float(rng.uniform(*NOVICE_WAITS_S)))
    _sway(script.poses, rng)


def _sway(poses: list[np.ndarray], rng: np.random.Generator) -> None:
    """Rotate the view of each pose by a slowly varying random angle with a standard deviation of 25 degrees."""
    angles = np.zeros(2)
    for n, pose in enumerate(poses):
        angles = 0.9 * angles + np.sqrt(1.0 - 0.9**2) * np.radians(25.0) * rng.standard_normal(2)
        about_x, about_y = angles
        turn_x = np.array([[1, 0, 0], [0, np.cos(about_x), -np.sin(about_x)], [0, np.sin(about_x), np.cos(about_x)]])
        turn_y = np.array([[np.cos(about_y), 0, np.sin(about_y)], [0, 1, 0], [-np.sin(about_y), 0, np.cos(about_y)]])
        poses[n] = pose.copy()
        poses[n][:3, :3] = pose[:3, :3] @ turn_x @ turn_y


def _wall_hugging(script: Any, case: TrainingCase, rng: np.random.Generator) -> None:
    """Inspect half of the segments in ascending order; the tip hits the wall above it for one of every two seconds."""
    for name in sorted(rng.choice(case.segments, size=len(case.segments) // 2, replace=False), key=SEGMENTS.index):
        _inspect(script, case, str(name))
    for n, pose in enumerate(script.poses):
        if n % 20 >= 10:
            script.poses[n] = _at_the_wall(pose, case.wall)


def _at_the_wall(pose: np.ndarray, wall: WallField) -> np.ndarray:
    """Return a pose moved up until its point is 0.05 mm from the wall; unchanged if it is nearer already."""
    up = -pose[:3, 1]
    reach = np.arange(0.0, 20.0, 0.05)
    away = wall.distance_mm(pose[:3, 3] + reach[:, None] * up)
    beyond = np.flatnonzero(away < 0.05)
    moved = pose.copy()
    moved[:3, 3] += max(0.0, float(reach[beyond[0]]) - 0.05 if len(beyond) else 0.0) * up
    return moved


HUMAN_MM_S = 20.0
"""Speed in mm/s of the slow optimal drive."""
CLASSES: dict[str, tuple[Callable[[Any, TrainingCase, np.random.Generator], None], dict[str, float]]] = {
    "optimal": (_optimal, {"speed_mm_s": 60.0, "hold_s": 1.2}),
    "experienced": (_experienced, {"speed_mm_s": 20.0, "hold_s": 10.2}),
    "novice": (_novice, {"speed_mm_s": 18.0, "hold_s": 3.0}),
    "wall-hugging": (_wall_hugging, {"speed_mm_s": 40.0, "hold_s": 1.5}),
}
"""Drivers with speed and duration of a hold; the fifth class moves at random."""


def flown(case: TrainingCase, driver: str, *, speed_mm_s: float | None = None) -> str:
    """Return the text of the recording of a driver's flight on a case, at the driver's speed or another one."""
    scripts, _ = _scripts()
    if driver == "random":
        return str(scripts.recording_text(scripts.random_flight(case.tree, 100 + case.seed), case.volume))
    drive, options = CLASSES[driver]
    options = options if speed_mm_s is None else options | {"speed_mm_s": speed_mm_s}
    script = scripts.Script(case.tree, **options)
    script.start(min(40.0, 0.5 * case.tree.root.length_mm))
    drive(script, case, np.random.default_rng([case.seed, *driver.encode()]))
    return str(scripts.recording_text(script.poses, case.volume))


def values_of(score: Score) -> dict[str, float]:
    """Return the values of a score by the names of `GAPS`."""
    document = score.to_json()
    found = {**document["published"], **document["without_mark"]}
    found["path_mm_per_segment"] = score.path_length_mm / max(score.diagnostic_completeness, 0.5)
    return {one.name: float("inf") if found[one.name] is None else float(found[one.name]) for one in GAPS}


def agreement(text: str, case: TrainingCase, score: Score) -> str:
    """Return an empty text if the independent scorer finds the same events and values, else the first difference."""
    _, independent = _scripts()
    expected = independent.independent_score(text, case.tree, case.wall)
    found = sorted((one.time_s, one.kind, one.name) for one in score.events if one.kind in COMPARED)
    if found != expected.pop("events"):
        return "events differ"
    values = {**score.to_json()["published"], **score.to_json()["without_mark"]}
    for name, value in expected.items():
        same = values[name] == value if value is None else np.isclose(values[name], value, rtol=1e-9, atol=0.0)
        if not same:
            return f"{name}: {values[name]} and {value}"
    return ""


def probability(better: list[float], worse: list[float], *, more_is_better: bool) -> float:
    """Return the probability that a value of the better class beats one of the worse class; equal values count half."""
    a, b = np.array(better)[:, None], np.array(worse)[None, :]
    sign = 1.0 if more_is_better else -1.0
    with np.errstate(invalid="ignore"):
        ahead = np.where(a == b, 0.5, np.where(sign * a > sign * b, 1.0, 0.0))
    return float(ahead.mean())


@dataclass(frozen=True, slots=True)
class _Flight:
    """Result of one flight."""

    case: str
    driver: str
    values: dict[str, float]
    seen: int
    num_segments: int
    steps: int
    time_s: float
    num_contacts: int
    doubts: tuple[str, ...]
    agrees: str | None
    """Empty if the independent scorer agrees, else the first difference; None if it was not run."""

    def line(self) -> str:
        """Return the result as a line of text."""
        same = "not compared" if self.agrees is None else self.agrees or "equal"
        return (
            f"{self.case:12} {self.driver:12} DC {self.seen:2} of {self.num_segments:2}  SP {self.steps:2}  PT "
            f"{self.time_s:5.0f} s  contacts {self.num_contacts:3}  doubts {','.join(self.doubts) or '-'}  "
            f"independent scorer: {same}"
        )

    @property
    def is_mastery(self) -> bool:
        """Whether the flight has 18 segments in order, under 120 s, without a doubt."""
        whole = self.seen == self.steps == len(SEGMENTS)
        return whole and self.time_s < MAX_OPTIMAL_S and not self.doubts


SLOW = "slow optimal"
"""Name of the optimal drive at a human speed, which is not ranked."""


def _flights(case: TrainingCase, *, compares: bool) -> Iterator[_Flight]:
    """Fly and score all classes on a case."""
    task = find_task("inspect-all")
    for driver in (*CLASSES, "random", SLOW):
        text = flown(case, "optimal", speed_mm_s=HUMAN_MM_S) if driver == SLOW else flown(case, driver)
        score = score_flight(
            case.tree, case.wall, flight_frames(read_recording(io.StringIO(text), Path("flight"))), task
        )
        yield _Flight(
            case.name,
            driver,
            values_of(score),
            score.diagnostic_completeness,
            score.num_case_segments,
            score.structured_progress,
            score.procedure_time_s,
            len(score.contacts),
            tuple(one.code for one in score.doubts),
            agreement(text, case, score) if compares and driver != SLOW else None,
        )


def _stored(file: Path | None) -> dict[str, list[_Flight]]:
    """Return the flights of each case that a file contains, by the case's seed."""
    if file is None or not file.exists():
        return {}
    document = json.loads(file.read_text(encoding="utf-8"))["cases"]
    return {
        seed: [_Flight(**{**one, "doubts": tuple(one["doubts"])}) for one in flights]
        for seed, flights in document.items()
    }


def main(arguments: list[str] | None = None) -> int:
    """Fly and score all classes on all cases, print each flight as it ends, and print the ranking."""
    parser = argparse.ArgumentParser(prog="python -m carina_bench.training", description=__doc__)
    parser.add_argument("--first", type=int, default=0, help="number of the first case: 0 is the bundled CT")
    parser.add_argument("--cases", type=int, default=20, help="number of cases")
    parser.add_argument(
        "--compare", type=int, default=10, help="number of the case from which the independent scorer is not run"
    )
    parser.add_argument("--json", type=Path, default=None, help="file that stores each finished case")
    parser.add_argument("--summarise", type=Path, nargs="+", default=None, help="files whose ranking is printed")
    options = parser.parse_args(arguments)
    found: dict[str, list[_Flight]] = {}
    for file in options.summarise or [options.json]:
        found |= _stored(file)
    if options.summarise is None:
        seeds = [n for n in range(options.first, options.first + options.cases) if str(n) not in found]
        for case in cases(seeds):
            began_s, flights = time.process_time(), []
            for flight in _flights(case, compares=case.seed < options.compare):
                print(flight.line(), flush=True)
                flights.append(flight)
            print(f"{case.name:12} {time.process_time() - began_s:.0f} s of processor time", flush=True)
            found[str(case.seed)] = flights
            if options.json is not None:
                text = json.dumps({"cases": {seed: [asdict(one) for one in made] for seed, made in found.items()}})
                write_whole(options.json, text.encode("utf-8"), what="the flights")
    _print_summary([one for flights in found.values() for one in flights])
    return 0


def _print_summary(flights: list[_Flight]) -> None:
    """Print how many optimal drives are mastery procedures, on how many both scorers agree, and the ranking."""
    rows = {name: [one.values for one in flights if one.driver == name] for name in (*CLASSES, "random")}
    for driver, speed_mm_s in (("optimal", CLASSES["optimal"][1]["speed_mm_s"]), (SLOW, HUMAN_MM_S)):
        own = [one for one in flights if one.driver == driver]
        passed = [one for one in own if one.is_mastery]
        print(
            f"{driver} drive at {speed_mm_s:.0f} mm/s: 18 of 18 in order, under {MAX_OPTIMAL_S:.0f} s, without doubt: "
            f"{len(passed)} of {len(own)} cases; time {min((one.time_s for one in passed), default=0.0):.0f} to "
            f"{max((one.time_s for one in passed), default=0.0):.0f} s, wall contacts "
            f"{sum(one.num_contacts for one in passed)}"
        )
    compared = [one for one in flights if one.agrees is not None]
    print(f"recordings scored equally by both scorers: {sum(not one.agrees for one in compared)} of {len(compared)}")
    _print_medians(rows)
    ranks = _ranks(rows)
    for one in ranks:
        print(
            f"{one['score']:28} {one['better']:12} before {one['worse']:12} {one['probability']:.3f}  ({one['source']})"
        )
    reached = sum(one["probability"] > LEAST_PROBABILITY for one in ranks)
    print(f"{reached} of {len(ranks)} pairs above {LEAST_PROBABILITY}")
    more = {measure.name: measure.more_is_better for measure in GAPS}
    for name, (better, worse), reason in NOT_JUDGED:
        chance = probability(
            [one[name] for one in rows[better]], [one[name] for one in rows[worse]], more_is_better=more[name]
        )
        print(f"not judged: {name} {better} before {worse} {chance:.3f}  ({reason})")


def _print_medians(rows: dict[str, list[dict[str, float]]]) -> None:
    """Print the medians of the published scores of each class beside those of its group."""
    groups = {one.group: one for one in REFERENCE_GROUPS}
    for driver, group in PUBLISHED_AS.items():
        texts = [
            f"{short} {np.median([one[name] for one in rows[driver]]):.{decimals}f} ({getattr(groups[group], name):g})"
            for name, short, decimals in MEDIANS
        ]
        remark = "; not calibrated" if driver == "optimal" else ""
        print(f"medians of {driver} (published: {group}){remark}: {', '.join(texts)}")


def _ranks(rows: dict[str, list[dict[str, float]]]) -> list[dict[str, Any]]:
    """Return the probability of each pair of `GAPS`."""
    found: list[dict[str, Any]] = []
    for measure in GAPS:
        for better, worse in measure.gaps:
            chance = probability(
                [one[measure.name] for one in rows[better]],
                [one[measure.name] for one in rows[worse]],
                more_is_better=measure.more_is_better,
            )
            found.append({"score": measure.name, "better": better, "worse": worse, "probability": chance,
                          "source": measure.source})  # fmt: skip
    return found


if __name__ == "__main__":
    raise SystemExit(main())
