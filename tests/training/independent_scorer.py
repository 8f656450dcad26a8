"""Second scorer of flights, written from the definitions of docs/training.md alone, for comparison with the product.

It steps through the flight frame by frame with counters; the product works on arrays of all frames. It shares only the
inputs with the product: tree, distance to the wall, and the lens of the instrument.
"""

from __future__ import annotations

import itertools
import json
import math
from typing import Any

import numpy as np

from carina.scopes import WallField, scope_preset
from carina.track import AirwayTree

ORDER = [f"RB{n}" for n in range(1, 11)] + ["LB1+2"] + [f"LB{n}" for n in (3, 4, 5, 6, 8, 9, 10)]


def usual_spelling(name: str | None) -> str:
    text = "".join((name or "").split())
    if text[:2].upper() not in ("RB", "LB") or not text[2:3].isdigit():
        return text
    text = text[:2].upper() + text[2:].lower()
    return "LB8" + text[5:] if text.startswith("LB7+8") else text


def beginnings(tree: AirwayTree, name: str) -> list[Any]:
    """Return the branch of a segment, or the highest branches of its parts, which arise separately."""

    def highest(wanted: Any) -> list[Any]:
        found, todo = [], [tree.root]
        while todo:
            one = todo.pop()
            if wanted(usual_spelling(one.name)):
                found.append(one)
            else:
                todo += [tree.branch(child) for child in one.children]
        order = [one.id for one in tree.branches]
        return sorted(found, key=lambda one: order.index(one.id))

    whole = highest(lambda text: text == name)
    if whole:
        return whole[:1]
    parts = highest(lambda text: text.startswith(name) and text[len(name) : len(name) + 1] in ("a", "b", "c", "d", "e"))
    if parts or name != "LB1+2":
        return parts
    halves = [beginnings(tree, "LB1"), beginnings(tree, "LB2")]
    return halves[0] + halves[1] if all(halves) else []


class Disk:
    """Opening of a branch."""

    def __init__(self, tree: AirwayTree, wall: WallField, branch: Any) -> None:
        self.branch = branch.id
        inside = {branch.id}
        for one in tree.branches:
            if one.parent in inside:
                inside.add(one.id)
        fork = branch.points[0]
        others = [spaced(one) for one in tree.branches if one.id not in inside]
        mouth, best = branch.points[-1], math.inf
        for one in tree.branches:
            if one.id not in inside:
                continue
            for point, radius in zip(*spaced(one), strict=True):
                if np.linalg.norm(point - fork) > 80.0:
                    continue
                gap = min(float((np.linalg.norm(line - point, axis=1) - radii).min()) for line, radii in others)
                far = float(np.linalg.norm(point - fork))
                if gap >= 0.25 * radius and far < best:
                    mouth, best = point, far
            if best < math.inf and one.id == branch.id:
                break  # Descendants count only if the branch itself has no such point.
        self.mouth = mouth
        way = mouth - fork if np.linalg.norm(mouth - fork) >= 0.5 else branch.points[-1] - fork
        self.into = way / np.linalg.norm(way)
        nearest = min(range(len(branch.points)), key=lambda n: float(np.linalg.norm(branch.points[n] - mouth)))
        self.radius = max(float(branch.radius[nearest]), float(wall.ball_mm(mouth)[0]))


def spaced(branch: Any, step_mm: float = 0.7) -> tuple[np.ndarray, np.ndarray]:
    """Return evenly spaced points of a centreline, and the radii there."""
    if (branch.id, step_mm, len(branch.points)) not in _SPACED:
        _SPACED[branch.id, step_mm, len(branch.points)] = _spaced(branch, step_mm)
    return _SPACED[branch.id, step_mm, len(branch.points)]


_SPACED: dict[Any, tuple[np.ndarray, np.ndarray]] = {}


def _spaced(branch: Any, step_mm: float) -> tuple[np.ndarray, np.ndarray]:
    run = [0.0]
    for a, b in zip(branch.points[:-1], branch.points[1:], strict=True):
        run.append(run[-1] + float(np.linalg.norm(b - a)))
    at = np.linspace(0.0, run[-1], max(2, math.ceil(run[-1] / step_mm) + 1))
    line = np.column_stack([np.interp(at, run, branch.points[:, k]) for k in range(3)])
    return line, np.interp(at, run, branch.radius)


class Judge:
    """Observations in single frames: the openings in sight, and the position of the tip in the airways."""

    def __init__(self, tree: AirwayTree, wall: WallField, scope: str, fov_deg: float) -> None:
        self.tree, self.wall = tree, wall
        preset = scope_preset(scope)
        self.tip_mm = preset.tip_mm / 2.0
        self.fov_deg = preset.usual_fov_deg
        self.requested_deg = fov_deg
        pixels = [(c + 0.5, r + 0.5) for r in range(64) for c in range(64) if math.hypot(c - 31.5, r - 31.5) <= 32.0]
        self.total = len(pixels)
        rays = preset.lens.optics(64, 64, preset.usual_fov_deg).directions_of(np.array(pixels))
        limit = min(fov_deg, preset.usual_fov_deg) / 2.0
        angle = np.degrees(np.arccos(np.clip(rays[:, 2], -1.0, 1.0)))
        in_picture = angle <= limit + 1e-6
        self.rays, self.pixels = rays[in_picture], np.array(pixels)[in_picture]
        lines = [(branch, *spaced(branch, 1.0)) for branch in tree.branches]
        self.line = np.concatenate([line for _, line, _ in lines])
        self.radii = np.concatenate([radii for _, _, radii in lines])
        self.line_places = [
            (branch, branch.length_mm * n / (len(line) - 1)) for branch, line, _ in lines for n in range(len(line))
        ]
        """Points of all centrelines, their radii, and the branch and the position along it of each."""
        self.names, self.disks, self.owners = [], [], []
        """Segments of the case; their openings; and the segment of each opening."""
        for name in ORDER:
            found = beginnings(tree, name)
            if found:
                self.names.append(name)
            for one in found:
                self.owners.append(name)
                self.disks.append(Disk(tree, wall, one))

    def openings(self, pose: np.ndarray) -> dict[int, float]:
        """Return the distance from the middle of the picture of each opening in sight, by its number."""
        eye = pose[:3, 3]
        gap = float(self.wall.distance_mm(eye)[0])
        if (0.6 * self.tip_mm - gap) / (0.45 * self.tip_mm) >= 0.5:
            return {}
        found = {}
        rays = self.rays @ pose[:3, :3].T
        for number, disk in enumerate(self.disks):
            towards = disk.mouth - eye
            if towards @ disk.into <= 0.0 or np.linalg.norm(towards) > 60.0:
                continue
            slope = rays @ disk.into
            with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
                far = (towards @ disk.into) / slope
                points = eye + far[:, None] * rays
                met = (slope > 1e-6) & (np.linalg.norm(points - disk.mouth, axis=1) <= disk.radius)
            which = np.flatnonzero(met)
            if len(which) < 0.01 * self.total:
                continue
            clear = self.reaches(eye, rays[which], far[which])
            if clear.sum() >= 0.01 * self.total and self.visible_area(disk, pose) >= 0.5:
                middle = self.pixels[which[clear]].mean(axis=0) - 32.0
                found[number] = math.hypot(*middle) / 32.0
        return found

    def visible_area(self, disk: Disk, pose: np.ndarray) -> float:
        """Return the share of the disk in the picture and before the walls, by the 200 points of the definition."""
        eye, forward = pose[:3, 3], pose[:3, 2]
        right = np.cross(disk.into, (1.0, 0.0, 0.0) if abs(disk.into[0]) < 0.9 else (0.0, 1.0, 0.0))
        right /= np.linalg.norm(right)
        up = np.cross(right, disk.into)
        points = []
        for n in range(200):
            angle, radius = n * math.pi * (3.0 - math.sqrt(5.0)), disk.radius * math.sqrt((n + 0.5) / 200)
            points.append(disk.mouth + radius * (math.cos(angle) * right + math.sin(angle) * up))
        points = np.array(points)
        far = np.linalg.norm(points - eye, axis=1)
        rays = (points - eye) / far[:, None]
        limit = math.radians(min(self.requested_deg, self.fov_deg) / 2.0)
        good = np.arccos(np.clip(rays @ forward, -1.0, 1.0)) <= limit
        good[good] = self.reaches(eye, rays[good], far[good])
        return float(good.mean())

    def reaches(self, eye: np.ndarray, rays: np.ndarray, far: np.ndarray) -> np.ndarray:
        """Return whether each line of sight is in the lumen at its points 0.5 mm apart, up to 1 mm before its end."""
        if len(rays) == 0:
            return np.ones(0, dtype=bool)
        at_mm = 0.5 * np.arange(max(0, math.floor((far.max() - 1.0) / 0.5)) + 1)
        points = eye + at_mm[:, None, None] * rays
        lumen = self.wall.distance_mm(points.reshape(-1, 3)).reshape(len(at_mm), len(rays)) > 0.0
        return (lumen | (at_mm[:, None] > far - 1.0)).all(axis=0)

    def opening_passed(self, tip: np.ndarray, branch: Any) -> int:
        """Return the number of the opening behind which the tip is, or -1."""
        first_branches = {disk.branch: number for number, disk in enumerate(self.disks)}
        one = branch
        while one.id not in first_branches:
            if one.parent is None:
                return -1
            one = self.tree.branch(one.parent)
        number = first_branches[one.id]
        disk = self.disks[number]
        return -1 if one.id == branch.id and (tip - disk.mouth) @ disk.into < 0.0 else number

    def place(self, tip: np.ndarray) -> tuple[Any, float]:
        """Return the branch of a point, and the position along it, mm."""
        n = int(np.argmin(np.linalg.norm(self.line - tip, axis=1) - self.radii))
        branch, along_mm = self.line_places[n]
        return branch, along_mm

    def lumen_is_in_middle(self, pose: np.ndarray, branch: Any, along_mm: float) -> bool:
        """Return whether a centreline 10 mm ahead is within a quarter of the field of view."""
        ends, todo = [], [(branch, along_mm + 10.0)]
        while todo:
            one, at_mm = todo.pop()
            if at_mm > one.length_mm and one.children:
                todo += [(self.tree.branch(child), at_mm - one.length_mm) for child in one.children]
                continue
            run = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(one.points, axis=0), axis=1))])
            ends.append([np.interp(at_mm, run, one.points[:, k]) for k in range(3)])
        for end in ends:
            way = np.array(end) - pose[:3, 3]
            away = float(np.linalg.norm(way))
            if away >= 1.0 and math.degrees(math.acos(min(1.0, float(way @ pose[:3, 2]) / away))) <= self.fov_deg / 4:
                return True
        return False


_JUDGES: dict[Any, Judge] = {}


def forget_cases() -> None:
    """Empty the caches, which identify branches by number and length, before another case is scored."""
    _JUDGES.clear()
    _SPACED.clear()


def judge_of(tree: AirwayTree, wall: WallField, scope: str, fov_deg: float) -> Judge:
    """Return the judge of a case and an instrument; its openings are computed once."""
    key = (id(tree), id(wall), scope, fov_deg)
    if key not in _JUDGES:
        _JUDGES[key] = Judge(tree, wall, scope, fov_deg)
    return _JUDGES[key]


def independent_score(text: str, tree: AirwayTree, wall: WallField) -> dict[str, Any]:
    """Return the scores and events of a recording of an inspection of all segments, clock from the cords."""
    lines = [json.loads(one) for one in text.splitlines()]
    view = next(one["view"] for one in lines if "view" in one)
    judge = judge_of(tree, wall, view["scope"], view["fov_deg"])
    moments = [(0.0, lines[0]["tip"]["lps_from_camera"])] + [(one["t"], one["pose"]) for one in lines if "pose" in one]
    length_s = max(one.get("t", one.get("end", 0.0)) for one in lines[1:])
    events: list[tuple[float, str, str]] = []
    seen_for = dict.fromkeys(range(len(judge.disks)), 0)
    known: set[int] = set()
    seen: list[str] = []
    middle, middle_for = "", 0
    last_visit, stepped, again = "", set(), 0
    behind_last, behind_for = -1, 0
    away_for, entered = {}, set()
    touched_at, contacts = -100, 0
    tips, red, centred, num = [], 0, 0, 0
    shown: Any = None
    started = False
    k, n = 0, 0
    last = math.floor(length_s * 10 + 1e-6)
    while k <= last:
        while n + 1 < len(moments) and moments[n + 1][0] <= k / 10 + 1e-9:
            n += 1
        pose = np.array(moments[n][1], dtype=np.float64).reshape(4, 4)
        gap = float(wall.distance_mm(pose[:3, 3])[0])
        started = started or gap > -0.5
        if not started:
            k += 1
            continue
        if not tips:
            events.append((k / 10, "clock-start", "cords"))
        if shown is None or moments[shown[0]][1] != moments[n][1]:
            branch, along_mm = judge.place(pose[:3, 3])
            shown = (n, judge.openings(pose), branch, judge.lumen_is_in_middle(pose, branch, along_mm))
        in_sight, branch = shown[1], shown[2]
        for number in seen_for:
            seen_for[number] = seen_for[number] + 1 if number in in_sight else 0
        behind = judge.opening_passed(pose[:3, 3], branch)
        # The time outside begins at the frame at which the last uninterrupted stay behind the opening had lasted for
        # 0.5 s.
        for number, (now_away, longest) in away_for.items():
            away = now_away + 1 if behind != number else 0
            away_for[number] = (away, max(longest, away))
        lens_is_clear = (0.6 * judge.tip_mm - gap) / (0.45 * judge.tip_mm) < 0.5
        opening_now = behind if lens_is_clear else -1
        behind_for = behind_for + 1 if opening_now == behind_last else 1
        behind_last = opening_now
        known |= {number for number, count in seen_for.items() if count == 6}
        if behind_last >= 0 and behind_for == 6:
            known.add(behind_last)
        for name in judge.names:
            parts = [number for number, owner in enumerate(judge.owners) if owner == name]
            if name not in seen and all(number in known for number in parts):
                seen.append(name)
                events.append((k / 10, "seen", name))
        arrivals = []
        if behind_last >= 0 and behind_for == 6:
            name = judge.owners[behind_last]
            if behind_last not in entered:
                arrivals.append((name, "visit"))
            elif away_for[behind_last][1] >= 6:
                again += 1
                events.append((k / 10, "revisit", name))
                arrivals.append((name, "counted"))
            entered.add(behind_last)
            away_for[behind_last] = (0, 0)
        named = [(off, judge.owners[number]) for number, off in in_sight.items() if off <= 0.5]
        central = [(off, ORDER.index(name), name) for off, name in named]
        now = min(central)[2] if central else ""
        middle_for = middle_for + 1 if now == middle else 1
        middle = now
        if now and middle_for == 11:
            arrivals.append((now, "visit"))
        for name, kind in arrivals:
            if name == last_visit:
                continue
            if kind == "visit":
                events.append((k / 10, "visit", name))
            before = judge.names.index(last_visit) if last_visit else -1
            if judge.names.index(name) == before + 1 and name not in stepped:
                stepped.add(name)
                events.append((k / 10, "progress", name))
            last_visit = name
        if float(wall.ball_mm(pose[:3, 3])[0]) <= judge.tip_mm + 0.1:
            if k - touched_at > 5:
                contacts += 1
                events.append((k / 10, "contact", branch.name or f"branch {branch.id}"))
            touched_at = k
        red += k < last and (0.6 * judge.tip_mm - gap) / (0.45 * judge.tip_mm) >= 0.5
        centred += shown[3]
        num += 1
        tips.append(pose[:3, 3])
        k += 1
    events.append((last / 10, "clock-end", "end of the attempt"))
    time_s = (num - 1) / 10
    return {
        "events": sorted(events),
        "diagnostic_completeness": len(seen),
        "structured_progress": len(stepped),
        "procedure_time_s": time_s,
        "mean_intersegmental_time_s": time_s / len(seen) if seen else None,
        "segments_revisited": again,
        "num_contacts": contacts,
        "red_out_s": red / 10,
        "lumen_in_middle": centred / num,
        "path_length_mm": sum(float(np.linalg.norm(b - a)) for a, b in itertools.pairwise(tips)),
        "smoothness": independent_smoothness(np.array(tips)),
    }


def independent_smoothness(tips: np.ndarray) -> float:
    """Return minus the logarithm of the dimensionless jerk by third differences of the positions."""
    third = tips[3:] - 3 * tips[2:-1] + 3 * tips[1:-2] - tips[:-3]
    squared = float((third**2).sum()) * 1000.0**2 / 10
    peak = max(float(np.linalg.norm(b - a)) * 10 for a, b in itertools.pairwise(tips))
    return -math.log(squared * ((len(tips) - 1) / 10) ** 3 / peak**2)
