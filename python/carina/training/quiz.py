"""Quizzes: the segment behind an opening, the place of the tip, or the opening towards a place in three slices."""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from carina.argument_checks import check_arguments, choice, instance, whole_from
from carina.display import one_line
from carina.errors import NoResultError
from carina.plan.turns.fork_view import hours_of, turned_hours
from carina.scopes import DEFAULT_SCOPE, Pose, ScopePreset, WallField, scope_preset
from carina.track import AirwayTree, Branch
from carina.training.flight_frames import FlightFrames, FlightOptics
from carina.training.handling import hour_text
from carina.training.openings_in_sight import branch_openings, openings_in_sight
from carina.training.segments import SURE_NAME, segments_of_case

QuizKind = Literal["name-opening", "where-are-you", "slices"]

MAX_QUESTIONS = 100
NUM_CHOICES = 4
BACK_MM = (10.0, 8.0, 12.0, 6.0, 15.0, 4.0)
"""Distances in mm before a fork at which the tip may look at an opening, the preferred ones first."""
LEAST_HOURS = 2.0
"""Minimum difference in clock hours between the openings of a fork from which a question is made."""
MAX_GENERATION = 5
"""Maximum generation of a branch whose fork is the subject of a question."""
LEAST_INTO_MM = 8.0
"""Minimum length in mm of a branch for a question that shows three slices beyond the fork."""
INTO_BRANCH = 0.4
"""Position of the tip in the branch that a question shows, as a share of the branch's length."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class QuizQuestion:
    """Quiz question about a bronchus: the pose from which it is seen, its name, and the names to choose from."""

    pose: Pose
    """Pose of the tip: it looks at the opening, or along the branch in which it is."""
    answer: str
    choices: tuple[str, ...]
    """Names in random order, the correct one included; for ``slices`` the clock hours of the openings, ascending, for
    an operator at the head end."""
    place_lps: tuple[float, float, float] | None = None
    """Place at which the three slices of the kind ``slices`` meet, LPS mm."""


@check_arguments(
    tree=instance(AirwayTree, "get one from carina.find_airways"),
    wall=instance(WallField, "make one with carina.wall_field"),
    kind=choice("name-opening", "where-are-you", "slices"),
    num=whole_from(1, MAX_QUESTIONS),
    seed=whole_from(0, 2**31),
)
def quiz_questions(
    tree: AirwayTree, wall: WallField, kind: QuizKind, *, num: int = 10, seed: int = 0
) -> tuple[QuizQuestion, ...]:
    """Return the questions of a quiz on a case; one seed gives the same questions.

    Questions contain only segments whose names are certain. For ``name-opening`` the tip is before a fork and looks at
    the opening of a segment, which is in sight by the rules of the scores; for ``where-are-you`` it is in a segment.
    For ``slices`` the tip is before a fork with all openings in sight, and three slices meet in one of the branches
    beyond the fork; the answer is the clock hour of the opening that leads there. No names are needed.

    Parameters
    ----------
    tree, wall
        Airways with names, and their wall.
    kind
        Kind of the questions.
    num
        Number of questions; fewer are returned if the case has fewer suitable segments.
    seed
        Seed of the order of the segments and of the choices.

    Returns
    -------
    tuple
        The questions, each about another segment.

    Raises
    ------
    NoResultError
        ``training.no-segments``: if the case has fewer than two suitable segments, or for ``slices`` no suitable fork.

    Examples
    --------
    >>> questions = quiz_questions(airways.tree, wall, "name-opening", num=3)  # doctest: +SKIP
    >>> questions[0].choices  # doctest: +SKIP
    ('RB9', 'RB6', 'RB10', 'RB8')
    >>> NUM_CHOICES
    4
    """
    rng = random.Random(seed)
    if kind == "slices":
        return _slice_questions(tree, wall, num, rng)
    segments = [
        (one.name, tree.branch(one.branch_ids[0]))
        for one in segments_of_case(tree)
        if len(one.branch_ids) == 1 and _is_certain(tree.branch(one.branch_ids[0]))
    ]
    posed = []
    for name, branch in segments:
        pose = _before_opening(tree, branch, wall) if kind == "name-opening" else _inside(branch)
        if pose is not None:
            posed.append((name, branch, pose))
    if len(posed) < 2:
        raise NoResultError(
            f"quiz: expected two segments or more with certain names and visible openings; found {len(posed)}; confirm "
            "the names in the window, or choose another case",
            code="training.no-segments",
        )
    rng.shuffle(posed)
    return tuple(QuizQuestion(pose, name, _choices(name, branch, segments, rng)) for name, branch, pose in posed[:num])


def _slice_questions(tree: AirwayTree, wall: WallField, num: int, rng: random.Random) -> tuple[QuizQuestion, ...]:
    """Return questions about the forks of a case, each about another fork."""
    forks = [one for one in tree.branches if one.generation < MAX_GENERATION and len(one.children) > 1]
    rng.shuffle(forks)
    found: list[QuizQuestion] = []
    for fork in forks:
        question = _slice_question(tree, fork, wall, rng)
        if question is not None:
            found.append(question)
        if len(found) == num:
            break
    if not found:
        raise NoResultError(
            "quiz: expected a fork whose openings can be seen together; found none; choose another case",
            code="training.no-segments",
        )
    return tuple(found)


def _slice_question(tree: AirwayTree, parent: Branch, wall: WallField, rng: random.Random) -> QuizQuestion | None:
    """Return a question about the fork at the end of a branch; None if its openings are not clearly apart in sight."""
    openings = branch_openings(tree, parent.children, wall)
    middle = np.mean([one.middle_lps for one in openings], axis=0)
    points, run = _way_to(tree, parent.id)
    reached = [one for one in openings if tree.branch(one.branch_id).length_mm >= LEAST_INTO_MM]
    if len(reached) < len(openings):
        return None
    for back_mm in BACK_MM:
        at = np.array([np.interp(run[-1] - back_mm, run, points[:, k]) for k in range(3)])
        pose = Pose.looking(at, middle - at)
        frames = _frames([pose.lps_from_camera], scope_preset(DEFAULT_SCOPE))
        if not openings_in_sight(frames, openings, wall, first=0, last=0).in_sight[0].all():
            continue
        ways = [pose.lps_from_camera[:3, :3].T @ (one.middle_lps - at) for one in openings]
        hours = [hours_of(float(way[0] / way[2]), float(way[1] / way[2])) for way in ways]
        apart = [abs((a - b + 6.0) % 12.0 - 6.0) for n, a in enumerate(hours) for b in hours[:n]]
        if min(apart) < LEAST_HOURS:
            continue
        branch = tree.branch(rng.choice(reached).branch_id)
        place = _along(branch, max(1.0 - INTO_BRANCH, LEAST_INTO_MM / branch.length_mm))
        texts = {one.branch_id: hour_text(hour) for one, hour in zip(openings, hours, strict=True)}
        if len(set(texts.values())) < len(texts):
            continue
        choices = tuple(sorted(texts.values(), key=lambda text: int(text.split()[0])))
        return QuizQuestion(pose, texts[branch.id], choices, (float(place[0]), float(place[1]), float(place[2])))
    return None


def turned_choice(choice: str) -> str:
    """Return a choice of the kind ``slices`` for a picture that is turned by 180 degrees."""
    return hour_text(turned_hours(float(choice.split(maxsplit=1)[0])))


def _is_certain(branch: Branch) -> bool:
    """Return whether a name may be used in a quiz: given by a person, or with a high confidence."""
    return branch.name_confidence is None or branch.name_confidence >= SURE_NAME


def _choices(name: str, branch: Branch, segments: Sequence[tuple[str, Branch]], rng: random.Random) -> tuple[str, ...]:
    """Return the correct name and the names of the segments nearest to the branch, in random order."""
    middle = branch.points[0]
    others = sorted(
        (one for one in segments if one[0] != name), key=lambda one: float(np.linalg.norm(one[1].points[0] - middle))
    )
    chosen = [name, *(other for other, _ in others[: NUM_CHOICES - 1])]
    rng.shuffle(chosen)
    return tuple(chosen)


def _before_opening(tree: AirwayTree, branch: Branch, wall: WallField) -> Pose | None:
    """Return a pose before the fork of a branch that looks at its opening; None if the opening is nowhere in sight."""
    if branch.parent is None:
        return None
    points, run = _way_to(tree, branch.parent)
    (opening,) = branch_openings(tree, [branch.id], wall)
    poses = []
    for back_mm in BACK_MM:
        at = np.array([np.interp(run[-1] - back_mm, run, points[:, k]) for k in range(3)])
        poses.append(Pose.looking(at, opening.middle_lps - at))
    frames = _frames([pose.lps_from_camera for pose in poses], scope_preset(DEFAULT_SCOPE))
    seen = openings_in_sight(frames, [opening], wall, first=0, last=len(poses) - 1).in_sight[:, 0]
    return next((pose for pose, is_seen in zip(poses, seen, strict=True) if is_seen), None)


def _way_to(tree: AirwayTree, branch_id: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the points (n, 3) of the centreline from the root to the end of a branch, and their positions (n,), mm."""
    lineage = tree.lineage(branch_id)
    points = np.concatenate([lineage[0].points, *(one.points[1:] for one in lineage[1:])])
    return points, np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def _along(branch: Branch, share: float) -> NDArray[np.float64]:
    """Return the point (3,) of a branch at a share of its length."""
    run = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(branch.points, axis=0), axis=1))])
    return np.array([np.interp(share * run[-1], run, branch.points[:, k]) for k in range(3)])


def _inside(branch: Branch) -> Pose | None:
    """Return a pose inside a branch that looks along it; None in a branch of one point."""
    run = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(branch.points, axis=0), axis=1))])
    if run[-1] <= 0.0:
        return None
    here, ahead = (
        np.array([np.interp(mm, run, branch.points[:, k]) for k in range(3)]) for mm in (INTO_BRANCH * run[-1], run[-1])
    )
    return Pose.looking(here, ahead - here)


def _frames(poses: list[NDArray[np.float64]], scope: ScopePreset) -> FlightFrames:
    """Return poses as the frames of a flight with an instrument."""
    num = len(poses)
    stacked = np.stack(poses)
    optics = FlightOptics(scope, False, scope.usual_fov_deg, False)
    none = np.zeros(num, dtype=np.int64)
    return FlightFrames(stacked, np.arange(num), none, (optics,), True, stacked, np.arange(num, dtype=np.float64))
