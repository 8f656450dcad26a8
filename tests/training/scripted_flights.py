"""Scripted drivers that fly through a phantom and record their flights: optimal, planned, wall-hugging and random."""

from __future__ import annotations

import io
import itertools
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from carina.commands import PlacePose
from carina.navigate import Navigator, Pilot, Recorder, Recording, case_key
from carina.navigate.recording import read_recording
from carina.scopes import Pose
from carina.track import AirwayTree, Branch
from carina.training import SEGMENTS
from carina.training.openings_in_sight import BranchOpening, branch_openings
from carina.training.segments import branches_named
from carina.volume import Volume

STEP_S = 0.1
VIEW = {"scope": "generic", "fov_deg": 120.0, "operator": "head"}


@dataclass
class Script:
    """Poses of a flight at intervals of 0.1 s."""

    tree: AirwayTree
    speed_mm_s: float = 60.0
    hold_s: float = 1.2
    offset_mm: float = 0.0
    """Distance of the tip beside the centreline, in the direction up."""
    poses: list[np.ndarray] = field(default_factory=list)
    _branch: int = 0
    _along_mm: float = 0.0
    _look: np.ndarray | None = None

    def line(self, branch_id: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the centreline from the root to the end of a branch, and the length along it."""
        lineage = self.tree.lineage(branch_id)
        points = np.concatenate([lineage[0].points, *(one.points[1:] for one in lineage[1:])])
        return points, np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])

    def at(self, branch_id: int, along_mm: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the position and the direction of the centreline at a length from the root."""
        points, run = self.line(branch_id)
        here, ahead = (
            np.array([np.interp(at, run, points[:, k]) for k in range(3)]) for at in (along_mm, along_mm + 6.0)
        )
        way = ahead - here
        if np.linalg.norm(way) < 1e-6:
            way = points[-1] - points[-2]
        return here, way / np.linalg.norm(way)

    def fork_mm(self, branch_id: int) -> float:
        """Return the length from the root to the beginning of a branch."""
        branch = self.tree.branch(branch_id)
        return 0.0 if branch.parent is None else float(self.line(branch.parent)[1][-1])

    def add(self, here: np.ndarray, look: np.ndarray) -> None:
        pose = Pose.looking(here, look).lps_from_camera.copy()
        pose[:3, 3] += self.offset_mm * -pose[:3, 1]
        self.poses.append(pose)
        self._look = look / np.linalg.norm(look)

    def go(self, branch_id: int, along_mm: float) -> None:
        """Move along the centrelines to a length from the root on the way to a branch, looking ahead."""
        ours = [one.id for one in self.tree.lineage(self._branch)]
        theirs = [one.id for one in self.tree.lineage(branch_id)]
        shared = [a for a, b in zip(ours, theirs, strict=False) if a == b]
        turn_mm = min(float(self.line(shared[-1])[1][-1]), self._along_mm, along_mm)
        if shared[-1] in (self._branch, branch_id):
            turn_mm = min(self._along_mm, along_mm)
        for line, start, end in ((self._branch, self._along_mm, turn_mm), (branch_id, turn_mm, along_mm)):
            num = int(np.ceil(abs(end - start) / (self.speed_mm_s * STEP_S)))
            for n in range(1, num + 1):
                here, way = self.at(line, start + (end - start) * n / num)
                self._turned(here, way)
        self._branch, self._along_mm = branch_id, along_mm

    def _turned(self, here: np.ndarray, wanted: np.ndarray) -> None:
        """Add a pose that is turned towards a direction by at most 20 degrees."""
        look = wanted if self._look is None else _towards(self._look, wanted, np.radians(20.0))
        self.add(here, look)

    def look_at(self, point: np.ndarray, seconds: float) -> None:
        """Turn towards a point, and hold the view for a time."""
        here, _ = self.at(self._branch, self._along_mm)
        while np.degrees(np.arccos(np.clip(self._look @ _unit(point - here), -1.0, 1.0))) > 1.0:
            self._turned(here, _unit(point - here))
        for _ in range(round(seconds / STEP_S)):
            self.add(here, point - here)

    def wait(self, seconds: float) -> None:
        self.poses += [self.poses[-1].copy() for _ in range(round(seconds / STEP_S))]

    def opening_of(self, name: str) -> tuple[Branch, BranchOpening]:
        """Return the branch of a name and its opening, which is computed once for each tree."""
        (branch,) = branches_named(self.tree, name)
        known = _OPENINGS.setdefault(id(self.tree), (self.tree, {}))[1]
        if name not in known:
            (known[name],) = branch_openings(self.tree, [branch.id])
        return branch, known[name]

    def inspect(self, name: str, *, back_mm: float = 8.0) -> None:
        """Go before the opening of a segment and hold it in the middle of the picture."""
        branch, opening = self.opening_of(name)
        # Twigs divide a bronchus; the position counts from the root.
        self.go(branch.parent, max(self.fork_mm(branch.id) - back_mm, 0.0))
        self.look_at(opening.middle_lps, self.hold_s)

    def enter(self, name: str, *, depth_mm: float = 8.0) -> None:
        """Drive into a segment, and hold the view there for a time."""
        branch, opening = self.opening_of(name)
        past_mm = float(np.linalg.norm(opening.middle_lps - branch.points[0])) + depth_mm
        self.go(branch.id, self.fork_mm(branch.id) + min(past_mm, branch.length_mm))
        self.wait(self.hold_s)

    def start(self, along_mm: float = 40.0) -> None:
        """Start in the trachea."""
        self._branch, self._along_mm = 0, along_mm
        self.add(*self.at(0, along_mm))


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)


def _towards(one: np.ndarray, other: np.ndarray, most_rad: float) -> np.ndarray:
    angle = float(np.arccos(np.clip(one @ other, -1.0, 1.0)))
    if angle <= most_rad:
        return other
    across = _unit(other - (other @ one) * one)
    return np.cos(most_rad) * one + np.sin(most_rad) * across


def optimal(tree: AirwayTree) -> list[np.ndarray]:
    script = Script(tree)
    script.start()
    for name in SEGMENTS:
        script.inspect(name)
    return script.poses


def entering(tree: AirwayTree) -> list[np.ndarray]:
    """Return a flight into each segment of the right upper and the left lower lobe, and into RB1 twice."""
    script = Script(tree, speed_mm_s=30.0, hold_s=0.8)
    script.start()
    for name in ("RB1", "RB2", "RB3", "RB1", "LB6", "LB8", "LB9", "LB10"):
        script.enter(name)
    return script.poses


def planned(tree: AirwayTree) -> list[np.ndarray]:
    """Return a slow flight that inspects the lower lobes only, the left lung first, with a revisit."""
    script = Script(tree, speed_mm_s=25.0, hold_s=2.0)
    script.start()
    for name in ("LB6", "LB8", "LB9", "LB10", "LB6", "RB6", "RB7", "RB8"):
        script.inspect(name)
    return script.poses


def wall_hugging(tree: AirwayTree) -> list[np.ndarray]:
    script = Script(tree, speed_mm_s=40.0, offset_mm=2.2)
    script.start()
    for name in ("RB1", "RB2", "RB3", "RB4", "RB5", "RB6"):
        script.inspect(name, back_mm=6.0)
    return script.poses


def random_flight(tree: AirwayTree, seed: int) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    script = Script(tree, speed_mm_s=70.0)
    script.start()
    inner = [one for one in tree.branches if 1 <= one.generation <= 4]
    for number in rng.integers(len(inner), size=8):
        branch = inner[int(number)]
        script.go(branch.id, script.fork_mm(branch.id) + float(rng.uniform(-6.0, 0.6 * branch.length_mm)))
        script.offset_mm = float(rng.choice([0.0, 1.5]))
        here, _ = script.at(branch.id, script._along_mm)
        script.look_at(here + script._look + rng.normal(0.0, 0.4, 3), float(rng.uniform(0.3, 1.4)))
    return script.poses


def recording_of(
    poses: list[np.ndarray],
    volume: Volume,
    *,
    step_s: float = STEP_S,
    view: dict[str, Any] | None = None,
    complete: bool = True,
) -> Recording:
    """Return the recording of poses at even intervals, written by `Recorder` and read again."""
    return read_recording(
        io.StringIO(recording_text(poses, volume, step_s=step_s, view=view, complete=complete)), Path("flight")
    )


_KEYS: dict[int, tuple[Volume, dict[str, Any]]] = {}
_OPENINGS: dict[int, tuple[AirwayTree, dict[str, BranchOpening]]] = {}
"""Keys of volumes and openings of trees by identity; each entry holds its object, whose identity is then not reused."""


def forget_cases() -> None:
    """Empty the caches, which hold volumes and trees."""
    _KEYS.clear()
    _OPENINGS.clear()


def recording_text(
    poses: list[np.ndarray],
    volume: Volume,
    *,
    step_s: float = STEP_S,
    view: dict[str, Any] | None = None,
    complete: bool = True,
    times_s: list[float] | None = None,
) -> str:
    """Return the text of a recording; ``times_s`` are the times of the poses after the first, if they are uneven."""
    file = io.StringIO()
    file.close = lambda: None  # type: ignore[method-assign]
    pilot = Pilot(Navigator(Pose(poses[0])))
    if id(volume) not in _KEYS:
        _KEYS[id(volume)] = volume, case_key(volume)
    case = _KEYS[id(volume)][1]
    recorder = Recorder(pilot, file, case=case, carina="0", now_s=0.0, view=VIEW if view is None else view)
    for n, pose in enumerate(poses[1:], start=1):
        recorder.tick(n * step_s if times_s is None else times_s[n - 1])
        pilot.apply(PlacePose(tuple(pose.ravel().tolist())))
    recorder.close()
    text = file.getvalue()
    return text if complete else text.removesuffix(text.splitlines(keepends=True)[-1])


def at_30_hz(poses: list[np.ndarray]) -> list[np.ndarray]:
    """Return three poses for each one: the tip moves evenly, and the picture turns at the end of each interval."""
    made = [poses[0]]
    for before, after in itertools.pairwise(poses):
        for n in (1, 2, 3):
            pose = (after if n == 3 else before).copy()
            pose[:3, 3] = before[:3, 3] + n / 3 * (after[:3, 3] - before[:3, 3])
            made.append(pose)
    return made


def header_of(text: str) -> dict[str, Any]:
    return json.loads(text.splitlines()[0])
