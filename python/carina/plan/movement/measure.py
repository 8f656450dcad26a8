"""Movement of a target measured from a second CT of the same patient, such as one in expiration.

Forks of the airways are matched by the names of their branches. The matched forks give a first smooth deformation,
which predicts where the surroundings of forks, vessels and target are in the second CT. Correlation of small cubes of
both CTs then finds the places exactly. The error at the target follows from leave-one-out cross-validation at places
near the target.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from carina.argument_checks import check_arguments, function, instance
from carina.display import one_line
from carina.display.progress import ProgressChoice, progress_function, shows_progress
from carina.errors import CancelledError, NoResultError, TrackingError
from carina.plan.movement.block_matching import Block, averaged, landmarks, match_blocks
from carina.plan.movement.deformation import Affine, Deformation, affine_fit, rigid_fit, rigid_motion, rotation_deg
from carina.plan.movement.forks import ForkShift, fork_points, named_forks
from carina.plan.movement.orientation import orientation_error
from carina.plan.movement.same_patient import (
    MIN_RIGID,
    breath_notes,
    check_affine,
    check_breath,
    check_extent,
    check_forks,
    check_gravity,
    check_inside,
    check_motion,
    check_other_ct,
    check_places,
    check_size,
    check_structure,
    cut_lungs_error,
    few_forks,
    no_airways,
)
from carina.plan.movement.target_movement import MAX_MOVED_MM, TargetMovement
from carina.plan.targets.nodule import Nodule
from carina.plan.targets.target import PlanTarget
from carina.track import Airways, AirwayTree, find_airways
from carina.volume import Volume
from carina.volume.inserted_structures import SECOND_CT_WORDS

Points = NDArray[np.float64]

CARINA = "Trachea"
"""Name of the branch that ends in the main carina."""
AFFINE_MM = 8.0
"""Maximum distance in mm of a fork from the affine motion of all forks; a fork farther off is an outlier."""
NEAR_MM, APART_MM, MAX_PLACES = 60.0, 8.0, 160
"""Search for vessels near a target: half side length of the cube in mm, minimum distance between points in mm,
maximum number."""
COARSE, FINE = Block(9.0, 1.5, 9.0), Block(7.5, 0.75, 3.0)
WIDE = Block(18.0, 1.0, 4.0)
"""Cubes at the forks of wide airways, which contain the walls of the airways."""
WIDE_NAMES = (CARINA, "RMB", "LMB", "BI")
MIN_RADIUS_MM, TARGET_RIM_MM = 3.0, 5.0
"""Minimum radius of a target, and width of the tissue round the target that is compared too, mm."""
OUTSIDE_MM = 2.0
"""Minimum distance in mm from the target's edge of a vessel that is matched with the second CT."""
SAME_MM = 1e-3
"""Distance in mm below which two points count as the same fork."""
MIN_SCORE = 0.6
"""Minimum correlation of a cube with the second CT at which the point counts as found."""
MAX_RESIDUAL_MM = 4.0
"""Maximum distance in mm of a point's shift from the shift that its neighbours predict."""
NUM_CHECKED = 20
"""Number of matched points, nearest to the target, from which the error of the target's shift is estimated."""
SHARE_WITHIN = 0.9
"""Share of the known points whose prediction error is at most the stated error."""
MAX_ERROR_MM = 15.0
"""Maximum error in mm that is stated; a measurement with a larger error is no better than the default movement."""
AGREE_MM = 2.0
"""Distance in mm up to which the shift found for the target itself always agrees with that of its neighbours."""
TURN_DEG = 4.0
"""Rotation in degrees between both CTs that breathing does not explain; above it the error is enlarged."""


@one_line
@dataclass(frozen=True, slots=True)
class MovementMeasurement:
    """Movement of a target between two CTs, with the shifts that it is based on."""

    movement: TargetMovement
    """Shift of the target relative to the main carina, with its error; input of `carina.plan_route`."""
    target_lps: tuple[float, float, float]
    """Place of the target in the first CT, LPS mm."""
    second_lps: tuple[float, float, float]
    """Place of the target in the second CT, LPS mm of the second CT."""
    carina_shift_lps: tuple[float, float, float]
    """Shift of the main carina in the coordinates of the CTs, mm; it includes a shift of the table."""
    forks: tuple[ForkShift, ...]
    """Forks that have a name in the trees of both CTs."""
    num_vessels: int
    """Number of vessel points near the target that were found in the second CT."""
    residual_mm: float
    """Median distance in mm between found points near the target and their prediction by neighbouring points."""
    breath_mm: float
    """Distance in mm from one rigid motion within which 90 % of the points are; small if the breath is the same in
    both CTs."""
    rotation_deg: float
    """Rotation between both CTs, degrees."""
    is_target_seen: bool
    """Whether the target itself was found in the second CT; otherwise its shift follows from its neighbours."""

    def to_json(self) -> dict[str, Any]:
        """Return the measurement as plain JSON types."""
        return {
            "movement": self.movement.to_json(),
            "target_lps": list(self.target_lps),
            "second_lps": list(self.second_lps),
            "carina_shift_lps": list(self.carina_shift_lps),
            "forks": [fork.to_json() for fork in self.forks],
            "num_vessels": self.num_vessels,
            "residual_mm": self.residual_mm,
            "breath_mm": self.breath_mm,
            "rotation_deg": self.rotation_deg,
            "is_target_seen": self.is_target_seen,
        }


@shows_progress
@check_arguments(
    volume=instance(Volume, "open a volume with carina.open_volume"),
    airways=instance(Airways, "get airways from carina.find_airways"),
    second_volume=instance(Volume, "open a volume with carina.open_volume"),
    second_airways=instance(Airways, "get airways from carina.find_airways", optional=True),
    cancel=function,
)
def measure_movement(
    volume: Volume,
    airways: Airways,
    target: PlanTarget | Nodule | ArrayLike,
    second_volume: Volume,
    second_airways: Airways | None = None,
    *,
    progress: ProgressChoice = None,
    cancel: Callable[[], bool] | None = None,
) -> MovementMeasurement:
    """Measure the movement of a target from this CT to a second CT of the same patient in the same pose.

    Parameters
    ----------
    volume, airways
        The CT of the plan, and its airways.
    target
        A target, a nodule, or a point, LPS mm.
    second_volume, second_airways
        The second CT, such as one in expiration, and its airways; they are found if None.
    progress
        False, True, None or ``f(what, fraction)``. True and None show a progress bar in a terminal or a notebook; False
        shows none.
    cancel
        Called often; the work stops when it returns True.

    Returns
    -------
    MovementMeasurement
        Its ``movement`` is an argument of `carina.plan_route`.

    Raises
    ------
    NoResultError
        If the second CT is not comparable: ``movement.same-ct``, ``movement.same-breath``, ``movement.few-forks``,
        ``movement.other-patient``, ``movement.pose``, ``movement.mirrored``, ``movement.half-chest``,
        ``movement.outside`` (the target), ``movement.no-airways`` or ``movement.too-uncertain``.
    CancelledError
        If ``cancel()`` returned True.

    Examples
    --------
    The second CT of this example is stretched by 6 % along the body, like a deeper breath.

    >>> import dataclasses
    >>> import carina
    >>> options = {"seed": 4, "spacing_mm": 1.2, "generations": 5, "nodule": True}
    >>> made = carina.generate_phantom(**options)
    >>> second = carina.generate_phantom(**options, noise_hu=10).volume
    >>> matrix = second.lps_from_ijk.copy()
    >>> matrix[:, 2] *= 1.06
    >>> second = dataclasses.replace(second, lps_from_ijk=matrix)
    >>> airways, airways_of_second = carina.find_airways(made.volume), carina.find_airways(second)
    >>> place = made.truth["nodule"]["centre_lps"]
    >>> print(carina.plan.measure_movement(made.volume, airways, place, second, airways_of_second).movement.words)
    Movement of the target measured from the second CT: less than 1 mm, ± 1 mm relative to the main carina
    """
    on_progress = progress_function(progress)

    def check_cancelled() -> None:
        if cancel is not None and cancel():
            raise CancelledError("measuring the movement was cancelled")

    def report(what: str, share: float | None) -> None:
        check_cancelled()
        if on_progress is not None:
            on_progress(what, share)

    report("comparing both CTs", 0.0)
    check_other_ct(volume, second_volume)
    check_size(second_volume, fork_points(airways.tree))
    if second_airways is None:
        try:
            second_airways = find_airways(second_volume, progress=report, cancel=cancel)
        except TrackingError as error:
            raise no_airways(second_volume) from error
    place, radius_mm = _place(target)
    try:
        forks = _named_forks((volume, second_volume), airways.tree, second_airways.tree)
        motion, fits = _motion(volume, second_volume, airways, forks)
    except NoResultError as error:
        raise _explained(error, (volume, second_volume), (airways.tree, second_airways.tree)) from error
    check_gravity(volume, second_volume)
    guess = Deformation(forks.first_lps[fits], (forks.second_lps - forks.first_lps)[fits], motion)
    check_inside(second_volume, place + guess.at(place[None])[0], radius_mm)
    report("matching vessels and forks", None)
    # The voxels of both CTs are averaged to one size, so that noise does not hide small vessels.
    first, second = averaged(volume), averaged(second_volume)
    searched = _places(first, airways, forks, place, radius_mm)
    matches = _matched((first, second), forks, searched, guess, check_cancelled)
    report("matching vessels and forks", None)
    check_places(matches.field.places, place)
    found = _measurement(matches, place, radius_mm)
    if not second_volume.source.inserted:
        return found
    return replace(found, movement=replace(found.movement, notes=(SECOND_CT_WORDS, *found.movement.notes)))


@dataclass(frozen=True, slots=True, eq=False)
class _Forks:
    """Forks that the trees of both CTs name, with their positions."""

    names: tuple[str, ...]
    first_lps: Points
    second_lps: Points
    """(n, 3) positions of the forks in the second CT; ``first_lps`` are those in the first CT, LPS mm."""

    @property
    def carina(self) -> int:
        """Index of the main carina."""
        return self.names.index(CARINA)


@dataclass(frozen=True, slots=True, eq=False)
class _Matches:
    """Places of the first CT that were searched in the second CT: named forks first, then other forks, then vessels."""

    volumes: tuple[Volume, Volume]
    forks: _Forks
    shifts: Points
    score: Points
    """(n,) correlation of the best match of each point of the first CT, 0 where no match was found."""
    field: Deformation
    """Deformation computed from the matches that agree with their neighbours."""
    num_vessels: int
    """Number of vessel points whose match in the second CT was found."""


def _explained(
    trouble: NoResultError, volumes: tuple[Volume, Volume], trees: tuple[AirwayTree, AirwayTree]
) -> NoResultError:
    """Return the error that names the cause of a refusal, such as a wrong orientation; else the refusal itself."""
    if trouble.code not in {"movement.other-patient", "movement.few-forks", "movement.pose"}:
        return trouble
    return orientation_error(*trees) or cut_lungs_error(trouble, *volumes) or trouble


def _named_forks(volumes: tuple[Volume, Volume], first: AirwayTree, second: AirwayTree) -> _Forks:
    """Return the forks that both trees name; raise an error for too few, or without the main carina."""
    forks = _Forks(*named_forks(first, second))
    if len(forks.names) < MIN_RIGID:
        raise few_forks(len(forks.names), volumes[1])
    if CARINA not in forks.names:
        raise NoResultError(
            "the main carina is not named in both CTs, so that no shift relative to it can be measured; check the "
            "airways of both CTs",
            code="movement.few-forks",
        )
    return forks


def _motion(volume: Volume, second: Volume, airways: Airways, forks: _Forks) -> tuple[Affine, NDArray[np.bool_]]:
    """Return the affine motion of the named forks and the mask of the forks that follow it, after all checks."""
    here, there = forks.first_lps, forks.second_lps
    rigid, fits = rigid_fit(here, there)
    check_motion(rigid, fits)
    motion = affine_fit(here[fits], there[fits], rigid)
    off = np.linalg.norm(here + motion.shifts(here) - there, axis=1)
    check_affine(motion, off)
    check_extent(volume, second, motion, fork_points(airways.tree))
    fits = off <= AFFINE_MM
    check_forks(forks.names, fits, second)
    return motion, fits


def _places(volume: Volume, airways: Airways, forks: _Forks, place: Points, radius_mm: float) -> tuple[Points, Points]:
    """Return the forks (n, 3), the named ones first, and the vessels near the target (m, 3), LPS mm."""
    every = fork_points(airways.tree)
    named = np.linalg.norm(every[:, None] - forks.first_lps[None], axis=2).min(axis=1) < SAME_MM
    step_mm = max(1.0, min(volume.spacing_mm))
    vessels = landmarks(volume, place, NEAR_MM, apart_mm=APART_MM, most=MAX_PLACES, step_mm=step_mm)
    # A point inside the target would not be independent of the target.
    vessels = vessels[np.linalg.norm(vessels - place, axis=1) > radius_mm + OUTSIDE_MM]
    return np.concatenate([forks.first_lps, every[~named]]), vessels


def _matched(
    volumes: tuple[Volume, Volume],
    forks: _Forks,
    searched: tuple[Points, Points],
    guess: Deformation,
    check_cancelled: Callable[[], None],
) -> _Matches:
    places = np.concatenate(searched)
    shifts, score = match_blocks(*volumes, places, guess, COARSE, report=check_cancelled)
    check_structure(score[: len(forks.names)], MIN_SCORE)
    agreeing = _consistent(places, shifts, score, guess.base)
    shifts, score = match_blocks(*volumes, places, agreeing, FINE, report=check_cancelled)
    for n in (n for n, name in enumerate(forks.names) if name in WIDE_NAMES):
        (shifts[n],), (score[n],) = match_blocks(*volumes, places[n][None], agreeing, WIDE)
    field = _consistent(places, shifts, score, guess.base)
    num_vessels = int((score[len(searched[0]) :] >= MIN_SCORE).sum())
    return _Matches(volumes, forks, shifts, score, field, num_vessels)


def _consistent(places: Points, shifts: Points, score: Points, motion: Affine) -> Deformation:
    """Return the deformation computed from those found points that agree with their neighbours."""
    found = score >= MIN_SCORE
    for most_mm in (2.0 * MAX_RESIDUAL_MM, MAX_RESIDUAL_MM):
        field = Deformation(places[found], shifts[found], motion)
        off = np.linalg.norm(field.at(places, beyond_mm=0.1) - shifts, axis=1)
        found = (score >= MIN_SCORE) & (off <= most_mm)
    return Deformation(places[found], shifts[found], motion)


def _measurement(matches: _Matches, place: Points, radius_mm: float) -> MovementMeasurement:
    forks, field = matches.forks, matches.field
    off = _left_out_mm(field, place)
    between_mm = float(np.quantile(off, SHARE_WITHIN, method="higher"))
    shift, target_mm, is_seen, notes = _target_shift(matches, place, radius_mm, between_mm)
    carina_shift, carina_mm = _carina_shift(matches)
    turn, turned_mm = rotation_deg(field.base), 0.0
    if turn > TURN_DEG:
        turned_mm = float(np.radians(turn) * np.linalg.norm(place - forks.first_lps[forks.carina]))
        notes.append(
            f"the patient is rotated by {turn:.0f} degrees against the first CT; the error includes this rotation"
        )
    voxel_mm = 0.5 * max(max(volume.spacing_mm) for volume in matches.volumes)
    error = math.hypot(target_mm, voxel_mm, carina_mm, turned_mm)
    breath_mm = _breath_mm(field)
    check_breath(breath_mm, 2.0 * voxel_mm)
    notes += breath_notes(breath_mm)
    moved = shift - carina_shift
    length = float(np.linalg.norm(moved))
    if length > MAX_MOVED_MM or error > MAX_ERROR_MM:
        raise NoResultError(
            f"the target seems to move by {length:.0f} \u00b1 {error:.0f} mm, which is not reliable; choose a CT in "
            "another breath or with thinner slices, or enter the movement by hand",
            code="movement.too-uncertain",
        )
    return MovementMeasurement(
        movement=TargetMovement.measured(_point(moved), error, tuple(notes)),
        target_lps=_point(place),
        second_lps=_point(place + shift),
        carina_shift_lps=_point(carina_shift),
        forks=_fork_shifts(matches),
        num_vessels=matches.num_vessels,
        residual_mm=float(np.median(off)),
        breath_mm=breath_mm,
        rotation_deg=turn,
        is_target_seen=is_seen,
    )


def _breath_mm(field: Deformation) -> float:
    """Return the distance in mm from the best rigid motion within which 90 % of the points are."""
    second = field.places + field.shifts
    off = np.linalg.norm(field.places + rigid_motion(field.places, second).shifts(field.places) - second, axis=1)
    return float(np.quantile(off, SHARE_WITHIN))


def _left_out_mm(field: Deformation, place: Points) -> Points:
    """Return the prediction errors in mm at the points nearest to the target, each left out in turn.

    Together with a point, those of its neighbours are left out that are nearer to it than any point is to the target.
    The errors then apply to the target.
    """
    away = np.linalg.norm(field.places - place, axis=1)
    order = np.argsort(away)[:NUM_CHECKED]
    predicted = field.at(field.places[order], beyond_mm=float(away.min()))
    off: Points = np.linalg.norm(predicted - field.shifts[order], axis=1)
    return off


def _target_shift(
    matches: _Matches, place: Points, radius_mm: float, between_mm: float
) -> tuple[Points, float, bool, list[str]]:
    """Return the shift (3,) of the target, its error in mm, whether the target itself was found, and notes."""
    around = matches.field.at(place[None])[0]
    block = Block(max(radius_mm, MIN_RADIUS_MM) + TARGET_RIM_MM, 1.0, max(4.0, between_mm + 2.0))
    (own,), (score,) = match_blocks(*matches.volumes, place[None], matches.field, block)
    apart_mm = float(np.linalg.norm(own - around))
    if score < MIN_SCORE:
        return (
            around,
            between_mm,
            False,
            [
                "the target was not recognised in the second CT; its shift follows from vessels and forks around it. "
                "Check on the slices of the second CT whether the target is still there"
            ],
        )
    if apart_mm <= max(between_mm, AGREE_MM):
        return own, max(between_mm, apart_mm), True, []
    note = (
        f"the second CT shows the target {apart_mm:.0f} mm from the place that vessels and forks around it predict; "
        "check on its slices whether the target has changed"
    )
    return around, max(between_mm, apart_mm), False, [note]


def _carina_shift(matches: _Matches) -> tuple[Points, float]:
    """Return the shift (3,) of the main carina and its error in mm beyond that of a voxel."""
    n = matches.forks.carina
    if matches.score[n] >= MIN_SCORE:
        return matches.shifts[n], 0.0
    return matches.field.at(matches.forks.first_lps[n][None], beyond_mm=0.1)[0], MAX_RESIDUAL_MM


def _fork_shifts(matches: _Matches) -> tuple[ForkShift, ...]:
    here = matches.forks.first_lps
    predicted = matches.field.at(here, beyond_mm=0.1)
    away = np.linalg.norm(matches.field.places[None] - here[:, None], axis=2)
    return tuple(
        ForkShift(
            branch=name,
            first_lps=_point(here[n]),
            shift_lps=_point(matches.shifts[n]),
            residual_mm=float(np.linalg.norm(predicted[n] - matches.shifts[n])),
            is_used=bool(away[n].min() < SAME_MM),
        )
        for n, name in enumerate(matches.forks.names)
    )


def _point(values: Points) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z


def _place(target: PlanTarget | Nodule | ArrayLike) -> tuple[Points, float]:
    """Return the middle of a target, LPS mm, and half its long diameter, mm; 0 for a point."""
    nodule = target.nodule if isinstance(target, PlanTarget) else target
    if isinstance(nodule, Nodule):
        return np.array(nodule.centre_lps, dtype=np.float64), 0.5 * nodule.long_mm
    return np.asarray(target, dtype=np.float64).reshape(3), 0.0
