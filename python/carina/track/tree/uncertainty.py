"""Places that the automatic search could not follow, and the confidence of each branch."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from carina.commands.fields import AirwayPlace, Count, Part, PointLps
from carina.track.tree.airway_tree import AirwayTree, Branch
from carina.volume.model import Volume

UncertaintyKind = Literal["lost", "blocked", "stump", "filled", "leak", "volume", "faint", "fine"]
Points = NDArray[np.float64]

FAINT = 0.5
"""Confidence below which a branch is probably no airway and is listed as uncertain."""
# Calibration of wall scores: (score, share of branches with this score that are true airways), rising. Isotonic fit on
# phantoms of the seeds 101 to 114, good and degraded, with strands beside the airways; verified on the seeds 201 to 214
# (docs/decisions/0137; carina_bench.track_confidence).
AIRWAY_SHARE = (
    *((0.0, 0.0), (0.260, 0.001), (0.619, 0.010), (0.798, 0.066), (0.874, 0.161), (0.913, 0.275), (0.936, 0.620)),
    *((0.962, 0.675), (0.975, 0.817), (0.986, 0.944), (0.992, 0.969), (0.997, 0.981), (1.0, 0.999)),
)
# Confidence of the thinnest airways. Their walls rise by less than the noise of a voxel, so each was judged by values
# averaged over 5 mm (0112). In four CTs, 1 of 131 such paths was not an airway.
THREAD_SHARE = 0.95
# Distance in mm from the path of a thinnest airway within which half of a branch's points must be for THREAD_SHARE.
NEAR_THREAD_MM = 1.5
# Distance in mm within which a branch's point belongs to a path that was followed with a probability.
NEAR_JUDGED_MM = 2.0
WALL_WEIGHT = 0.2
"""Weight of the log odds of a branch's walls relative to the log odds of the path along the branch."""
SUREST_WALLS, SUREST_WAY = 0.99, 0.995
MAX_COMBINED = 0.94
"""Maximum confidence from path and walls together, unless one of the two alone is higher."""
# Walls are means of three sections and of neighbouring steps, so their noise grows more slowly than that of a voxel. Up
# to this noise, on which AIRWAY_SHARE was fitted, the noise of a voxel is used.
USUAL_NOISE_HU = 25.0
# Exponent of the growth of a wall measurement's noise above USUAL_NOISE_HU.
NOISE_POWER = 0.75
# Limits for thin branches in a CT with deep rims: in painted CTs with a sharp kernel, one in ten of the best-scoring
# lumens of this width is a rim that looks like a wall.
SHARP_RIM_HU = 15.0
# Median radius in voxels below which a branch counts as thin.
THIN_VOXELS = 2.0
# Maximum confidence of a thin branch in a CT with dark rims beside edges.
MAX_BESIDE_RIMS = 0.95
# Length in mm of the end of a branch that is not judged, because it is the blind end of the lumen.
BLUNT_MM = 2.0
# Number of cross-sections of a branch at which its wall is judged.
NUM_SECTIONS = 12
# Number of directions, evenly round a cross-section, in which a wall is searched.
NUM_SIDES = 16


class Uncertainty(AirwayPlace, frozen=True, kw_only=True):
    """Place where the automatic airways end too early, or that the user should check.

    ``branch_id`` is the branch that ends or is uncertain there; None for the whole tree.
    """

    kind: UncertaintyKind
    """Kind of the uncertain place.

    ``lost``: the search lost the airway, although its calibre shows that it continues; the CT proves no disease.
    ``blocked``: soft tissue continues the bronchus beyond the end of its lumen. ``stump``: a wall closes the
    bronchus in every direction. ``filled``: secretions or other material narrow or fill the lumen, and the bronchus
    continues; the place is the middle of that part. ``leak``: the search would have leaked into the lung.
    ``volume``: the scan ends there. ``faint``: the branch may not be an airway. ``fine``: from here on the CT is too
    coarse; once for the whole tree.
    """
    width_mm: float
    """Diameter in mm of the airway at the last point where it is visible.

    For ``fine``: the median of the ends that are this thin. For ``filled``: that of the circle with the area of the
    remaining air, 0 without air.
    """
    confidence: Part | None
    """Confidence of a ``faint`` branch; None for other kinds."""
    num_ends: Count | None
    """Number of thin ends, for ``fine``; None for other kinds."""
    voxel_mm: float | None
    """Mean edge of a voxel in mm, for ``fine``; None for other kinds."""
    length_mm: float | None = None
    """Length in mm of the filled part for ``filled``, or of the soft tissue for ``blocked``."""
    calibre_mm: float | None = None
    """Diameter in mm between the inner walls through the filling, for ``filled``; None if it cannot be measured."""
    calibre_error_mm: float | None = None
    """Half of the interval in mm that should contain ``calibre_mm``."""
    beyond_lps: PointLps | None = None
    """Point in the air beyond a ``filled`` place to which no path leads, LPS in mm: the target of a bridge."""

    slice_number: Count | None = None
    """Slice of the place, counted from the feet, from 1; None in cases of earlier versions."""
    num_slices: Count | None = None
    """Number of slices of the scan, counted in the same direction."""
    has_clips: bool = False
    """Whether surgical clips are at the end of a ``stump``."""

    @property
    def slice_text(self) -> str:
        """Text such as (slice 37 of 104 from the feet); empty if the slice is unknown."""
        return slice_text(self.slice_number, self.num_slices)

    @property
    def statement(self) -> str:
        """Text on what is visible at the place; used by the window, the command line, reports and exports."""
        width = f"{self.width_mm:.1f} mm wide{self.slice_text}"
        match self.kind:
            case "volume":
                return f"the scan ends here, but the airway, {width}, continues"
            case "leak" | "lost":
                return f"lost here, {width}"
            case "blocked":
                if self.length_mm is None:
                    # Cases of earlier versions stored every lost end as blocked, without evidence.
                    return f"lost here, {width}"
                return (
                    f"the lumen ends here, {width}; soft tissue continues the bronchus over at least "
                    f"{self.length_mm:.0f} mm"
                )
            case "stump":
                clips = ", with surgical clips" if self.has_clips else ""
                return f"the bronchus ends here, {width}, and a wall closes its end{clips}"
            case "filled":
                return _filled_statement(self)
            case "faint":
                return f"its wall is barely visible (confidence {self.confidence:.2f}){self.slice_text}"
            case "fine":
                ends = "the thinnest branch end" if self.num_ends == 1 else f"the {self.num_ends} thinnest branch ends"
                return (
                    f"this CT ({self.voxel_mm:.2f} mm voxels) does not reliably show airways narrower than "
                    f"{self.width_mm:.1f} mm, the median width at {ends}: there are smaller airways that are not shown"
                )

    @property
    def explanation(self) -> str | None:
        """Text on possible reasons, the same for all places of one kind; None if the CT gives none."""
        match self.kind:
            case "leak":
                return "its wall is too thin here, and the search would have leaked into the lung"
            case "blocked" if self.length_mm is not None:
                return "possibly mucus, a tumour or a collapsed airway"
            case "filled":
                return (
                    "possibly secretions or a mucus plug; a CT cannot distinguish these from a tumour or a collapsed "
                    "airway"
                )
            case "faint":
                return "it may not be an airway"
            case _:
                return None

    @property
    def reason(self) -> str:
        """Statement on the uncertain place, with its explanation."""
        return self.statement if self.explanation is None else f"{self.statement}: {self.explanation}"


def slice_text(number: int | None, count: int | None) -> str:
    """Return the text of a slice with a leading blank; empty if the slice is unknown."""
    return "" if number is None or count is None else f" (slice {number} of {count} from the feet)"


def slice_from_feet(volume: Volume, point_lps: Points) -> tuple[int, int]:
    """Return the slice number of a point, counted from the feet, from 1, and the number of slices.

    Slices are across the axis of the volume that is nearest to the patient's long axis.
    """
    up = volume.lps_from_ijk[2, :3] / np.array(volume.spacing_mm)
    axis = int(np.argmax(np.abs(up)))
    count = volume.shape_zyx[2 - axis]
    at = int(np.clip(np.rint(volume.to_ijk(point_lps)[axis]), 0, count - 1))
    return (at + 1 if up[axis] > 0.0 else count - at), count


def without_unproven_blocks(places: Sequence[Uncertainty]) -> tuple[Uncertainty, ...]:
    """Return the places with ``lost`` in place of ``blocked`` if no soft tissue was measured.

    Cases of earlier versions store every end that was lost as ``blocked``.
    """
    return tuple(
        msgspec.structs.replace(place, kind="lost") if place.kind == "blocked" and place.length_mm is None else place
        for place in places
    )


def _filled_statement(place: Uncertainty) -> str:
    """Return the text about a narrowed or filled place, without its possible reasons."""
    if place.calibre_mm is None:
        bronchus = "; its calibre from wall to wall cannot be measured here"
    else:
        width = f"{place.calibre_mm:.1f} \u00b1 {place.calibre_error_mm or 0.0:.1f} mm"
        bronchus = f" in a bronchus {width} wide from wall to wall"
    air = "no air is visible" if place.width_mm == 0.0 else f"the air is {place.width_mm:.1f} mm wide"
    beyond = "" if place.beyond_lps is None else "; there is an airway beyond it, which a bridge can reach"
    return f"narrowed or filled here over {place.length_mm or 0.0:.0f} mm{place.slice_text}: {air}{bronchus}{beyond}"


def filled_place(
    at: Points,
    branch_id: int,
    *,
    air_mm: float,
    length_mm: float,
    calibre_mm: float | None,
    calibre_error_mm: float | None,
    beyond_lps: Points | None,
) -> Uncertainty:
    """Return a place where a lumen is narrowed or filled; see the fields of :class:`Uncertainty`."""
    return Uncertainty(
        lps=(float(at[0]), float(at[1]), float(at[2])),
        kind="filled",
        branch_id=branch_id,
        width_mm=air_mm,
        confidence=None,
        num_ends=None,
        voxel_mm=None,
        length_mm=length_mm,
        calibre_mm=calibre_mm,
        calibre_error_mm=calibre_error_mm,
        beyond_lps=None if beyond_lps is None else (float(beyond_lps[0]), float(beyond_lps[1]), float(beyond_lps[2])),
    )


def with_confidence(
    volume: Volume,
    tree: AirwayTree,
    noise: float,
    threads_lps: Points | None = None,
    *,
    thread_share: float = THREAD_SHARE,
    judged: NDArray[np.float64] | None = None,
    rims_hu: float | None = None,
) -> AirwayTree:
    """Set the confidence of each branch from the values of the CT across it.

    The score of a section is the product of three values, each from 0 to 1: the share of sides with a wall; the rise
    of the wall above the lumen relative to the noise of a wall (``1 - exp(-rise / 3 wall_noise)``); and a factor for
    the diameter, which rises from 0.5 to 1 at 2 voxels, because a thinner lumen is blurred. A branch has the median
    score of its sections. The score is then converted to a probability: the share of phantom branches with this
    score that are true airways.

    Parameters
    ----------
    volume
        The CT.
    tree
        The airway tree.
    noise
        Standard deviation of the values in the air of the trachea.
    threads_lps
        (n, 3) points along the thinnest airways, LPS in mm, which were judged by further evidence.
    thread_share
        Confidence of a branch along ``threads_lps`` whose own score is lower.
    judged
        (n, 4) points, LPS in mm, and probability, along airways that were followed beyond the flood. In a branch
        along them the walls have less weight, because noise and interpolation may simulate a wall.
    rims_hu
        Depth of the dark rims that the kernel leaves beside edges; None if there are none.
    """
    branches = tuple(_branch_confidence(volume, branch, noise, threads_lps, thread_share) for branch in tree.branches)
    if judged is not None and len(judged):
        branches = tuple(with_path_probability(branch, judged) for branch in branches)
    if rims_hu is not None and rims_hu >= SHARP_RIM_HU:
        voxel_mm = float(np.cbrt(np.prod(volume.spacing_mm)))
        branches = tuple(_beside_rims(branch, voxel_mm) for branch in branches)
    return dataclasses.replace(tree, branches=branches)


def with_path_probability(branch: Branch, judged: NDArray[np.float64]) -> Branch:
    """Combine the confidence of a branch's walls with the probability of the path along it.

    Branches away from a path with a probability stay unchanged. A confidence above 0.94 is at most that of the walls
    and that of the path, because a branch is certain only if both are.
    """
    off_mm = np.linalg.norm(branch.points[:, None] - judged[None, :, :3], axis=2)
    is_near = off_mm.min(axis=1) <= NEAR_JUDGED_MM
    if branch.confidence is None or is_near.mean() < 0.5:
        return branch
    way = min(float(np.median(judged[off_mm.argmin(axis=1)[is_near], 3])), SUREST_WAY)
    walls = min(max(branch.confidence, 1.0 - SUREST_WALLS), SUREST_WALLS)
    odds = way / (1.0 - way) * (walls / (1.0 - walls)) ** WALL_WEIGHT
    confidence = max(min(odds / (1.0 + odds), MAX_COMBINED), min(way, branch.confidence))
    return dataclasses.replace(branch, confidence=round(confidence, 3))


def _beside_rims(branch: Branch, voxel_mm: float) -> Branch:
    is_thin = float(np.median(branch.radius)) < THIN_VOXELS * voxel_mm
    if branch.confidence is None or not is_thin:
        return branch
    return dataclasses.replace(branch, confidence=min(branch.confidence, MAX_BESIDE_RIMS))


def _branch_confidence(
    volume: Volume, branch: Branch, noise: float, threads_lps: Points | None, thread_share: float
) -> Branch:
    own = judged(volume, branch, noise)
    if threads_lps is None or own.confidence is None or own.confidence >= thread_share:
        return own
    low, high = branch.points.min(axis=0) - NEAR_THREAD_MM, branch.points.max(axis=0) + NEAR_THREAD_MM
    near = threads_lps[((threads_lps >= low) & (threads_lps <= high)).all(axis=1)]
    if not len(near):
        return own
    apart_mm = np.linalg.norm(branch.points[:, None] - near[None], axis=2).min(axis=1)
    is_thread = float((apart_mm <= NEAR_THREAD_MM).mean()) >= 0.5
    return dataclasses.replace(own, confidence=thread_share) if is_thread else own


def judged(volume: Volume, branch: Branch, noise: float) -> Branch:
    """Return a branch with the confidence that its walls give, see :func:`with_confidence`."""
    share = np.interp(_wall_score(volume, branch, noise), *np.array(AIRWAY_SHARE).T)
    return dataclasses.replace(branch, confidence=round(float(share), 3))


def wall_noise(noise: float) -> float:
    """Return the noise of a wall measurement, from the noise of a voxel in the air of the trachea.

    Examples
    --------
    >>> wall_noise(20.0), round(wall_noise(60.0), 1)
    (20.0, 48.2)
    """
    return noise if noise <= USUAL_NOISE_HU else USUAL_NOISE_HU * (noise / USUAL_NOISE_HU) ** NOISE_POWER


def _wall_score(volume: Volume, branch: Branch, noise: float) -> float:
    noise = wall_noise(noise)
    steps = np.linalg.norm(np.diff(branch.points, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    # Leave out the forks, where one side is open.
    from_mm = min(float(branch.radius[0]), 0.3 * along[-1])
    at = np.linspace(from_mm, max(along[-1] - min(BLUNT_MM, 0.2 * along[-1]), from_mm), NUM_SECTIONS)
    place = np.stack([np.interp(at, along, branch.points[:, axis]) for axis in range(3)], axis=1)
    ahead = np.stack([np.interp(at + 1.0, along, branch.points[:, axis]) for axis in range(3)], axis=1)
    behind = np.stack([np.interp(at - 1.0, along, branch.points[:, axis]) for axis in range(3)], axis=1)
    tangent = ahead - behind
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
    helper = np.eye(3)[np.argmin(np.abs(tangent), axis=1)]
    across = np.cross(tangent, helper)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    up = np.cross(tangent, across)
    angle = 2.0 * np.pi * np.arange(NUM_SIDES) / NUM_SIDES
    sides = np.cos(angle)[None, :, None] * across[:, None, :] + np.sin(angle)[None, :, None] * up[:, None, :]
    radius = np.interp(at, along, branch.radius)
    spacing = np.array(volume.spacing_mm)
    step_mm = 0.5 * float(spacing.min())
    # The wall of an airway is thinner than its radius; blur and slice thickness add to it.
    reach_mm = 2.0 * radius.max() + 1.5 + float(spacing.max())
    off = np.arange(0.0, reach_mm, step_mm)
    points = place[:, None, None, :] + sides[:, :, None, :] * off[None, None, :, None]
    values = _values_at(volume, points.reshape(-1, 3)).reshape(NUM_SECTIONS, NUM_SIDES, len(off))
    # Average three sections and neighbouring steps: a single noisy voxel is not a wall.
    values = (values + np.roll(values, 1, axis=0) + np.roll(values, -1, axis=0)) / 3.0
    lumen = values[:, :, 0].mean(axis=1)
    rise = values.max(axis=2) - lumen[:, None]
    walled = (rise > 3.0 * noise).mean(axis=1)
    contrast = 1.0 - np.exp(-np.maximum(np.median(rise, axis=1), 0.0) / (3.0 * max(noise, 1e-6)))
    calibre = np.clip(0.5 + 0.25 * 2.0 * radius / float(np.cbrt(np.prod(spacing))), 0.5, 1.0)
    return float(np.clip(np.median(walled * contrast * calibre), 0.0, 1.0))


def _values_at(volume: Volume, points: Points) -> Points:
    """Return the values of the voxels nearest to (n, 3) points (LPS, mm), clamped to the edge of the volume."""
    shape = np.array(volume.shape_zyx[::-1])
    i, j, k = np.clip(np.floor(volume.to_ijk(points) + 0.5).astype(int), 0, shape - 1).T
    values: Points = volume.hu_zyx[k, j, i].astype(np.float64)
    return values
