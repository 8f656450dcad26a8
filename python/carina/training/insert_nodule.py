"""Insertion of a nodule into a CT for training, blended with the blur and the noise of the CT."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from carina.argument_checks import check_arguments, choice, flag, instance, lps_point, number_from, whole_from
from carina.display import one_line
from carina.errors import NoResultError, UsageError
from carina.plan.cubic_box import Box, lung_median_hu, smoothed
from carina.plan.targets.region import is_outside_body
from carina.track import Airways
from carina.training.ct_texture import SURROUND_MM, CtTexture, measured_texture
from carina.training.nodule_shape import NoduleShape
from carina.volume import Note, Volume
from carina.volume.inserted_structures import INSERTED, structure_text, with_inserted
from carina.volume.mask_distances import ball_distance, distance_from

NoduleKind = Literal["solid", "part-solid", "ground-glass"]

DIAMETER_MM = (4.0, 30.0)
"""Range of the diameter in mm; a larger one is a mass, not a nodule (Fleischner Society 2017)."""
SOLID_HU, GLASS_HU = 30.0, -600.0
"""Densities in HU of solid tissue and of ground glass, by general knowledge."""
CORE_SHARE = 0.5
"""Diameter of the solid core of a part-solid nodule as a share of the whole diameter."""
SURROUNDINGS_MM, WIDER_MM = 60.0, 130.0
"""Half side in mm of the part of the CT in which blur and noise are measured, and of the larger part that replaces it.

The larger part is used if the first has too few edges or too little soft tissue, as across thick slices.
"""
CELL_MM = 0.3
"""Maximum size in mm of the cells from which the share of the nodule in a voxel is computed."""
SOFT_HU = -500.0
"""Density in HU above which smoothed voxels are no lung."""
THICK_MM = 3.5
"""Radius in mm of the largest ball in soft tissue from which the tissue is chest wall or mediastinum, no vessel."""
WALL_MARGIN_MM, AIRWAY_WALL_MM = 1.0, 1.2
"""Minimum distance in mm of a nodule from chest wall and mediastinum, and from the lumen of an airway."""
VESSEL_MM3 = 4.0
"""Volume in mm3 of soft tissue inside the nodule from which the nodule overlaps a vessel."""
BARE_AIR_HU = -970.0
"""Median density in HU below which a place contains air without lung tissue, so that it gets no nodule."""
MAX_TRIES = 4000
TRIAL_POINTS, TRIAL_SOFT_SHARE = 400, 0.2
"""Number of points in a nodule at which a random position is tried first, and largest share of soft tissue there."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class InsertedNodule:
    """A CT with an inserted nodule, and the exact nodule."""

    volume: Volume
    """The CT with the nodule; its permanent note and its title say that a nodule was inserted."""
    kind: NoduleKind
    centre_lps: tuple[float, float, float]
    diameter_mm: float
    """Diameter of the ball of equal volume, mm."""
    volume_mm3: float
    """Volume of the nodule in mm3, with the ground glass."""
    core_diameter_mm: float | None
    """Diameter of the solid core of a part-solid nodule, mm; None for the other kinds."""
    density_hu: float
    spiculation: float
    seed: int
    lung_hu: float
    """Median density of the lung at the position before the insertion, HU."""
    texture: CtTexture
    """Blur and noise of the surroundings that the nodule received."""
    replaces_vessels: bool
    """Whether the nodule overlaps vessels, which it replaces."""

    @property
    def note(self) -> Note:
        """Permanent note of the CT about all inserted nodules."""
        return next(note for note in self.volume.source.notes if note.code == INSERTED)

    def to_json(self) -> dict[str, Any]:
        """Return the truth of the nodule as plain JSON types."""
        return {
            "format": "carina-inserted-nodule",
            "version": 1,
            "kind": self.kind,
            "centre_lps": list(self.centre_lps),
            "diameter_mm": self.diameter_mm,
            "volume_mm3": round(self.volume_mm3, 3),
            "core_diameter_mm": self.core_diameter_mm,
            "density_hu": self.density_hu,
            "spiculation": self.spiculation,
            "seed": self.seed,
            "lung_hu": round(self.lung_hu, 1),
            "sigma_mm": [round(one, 3) for one in self.texture.sigma_mm],
            "gain": round(self.texture.gain, 3),
            "noise_hu": round(self.texture.noise_hu, 2),
            "replaces_vessels": self.replaces_vessels,
            "inserted": list(self.volume.source.inserted),
        }


_CHECKS = {
    "volume": instance(Volume, "open a volume with carina.open_volume"),
    "airways": instance(Airways, "get airways from carina.find_airways"),
    "diameter_mm": number_from(*DIAMETER_MM, unit="mm"),
    "spiculation": number_from(0.0, 1.0),
    "seed": whole_from(0, 2**32 - 1),
    "through_vessels": flag,
}


@check_arguments(
    **_CHECKS,
    centre_lps=lps_point(),
    kind=choice(*get_args(NoduleKind)),
    core_diameter_mm=number_from(2.0, DIAMETER_MM[1], optional=True, unit="mm"),
    density_hu=number_from(-750.0, 300.0, optional=True, unit="HU"),
)
def insert_nodule(
    volume: Volume,
    airways: Airways,
    centre_lps: ArrayLike,
    *,
    kind: NoduleKind = "solid",
    diameter_mm: float = 10.0,
    core_diameter_mm: float | None = None,
    density_hu: float | None = None,
    spiculation: float = 0.0,
    seed: int = 0,
    through_vessels: bool = False,
) -> InsertedNodule:
    """Insert a nodule into a CT for training; the result is marked permanently as *inserted*.

    Solid tissue replaces the lung, with noise of the measured spectrum; ground glass is added to the lung, whose noise
    and vessels stay. The boundary is the exact share of each voxel, blurred as the edges of the CT around it.

    Parameters
    ----------
    volume
        The CT in HU; not modified.
    airways
        Its airways, which the nodule must not touch.
    centre_lps
        (3,) centre of the nodule, LPS mm.
    kind
        ``solid``, ``part-solid`` or ``ground-glass``.
    diameter_mm
        Diameter of the ball of the same volume, 4 to 30 mm.
    core_diameter_mm
        Diameter of the solid core of a part-solid nodule; None for half the diameter.
    density_hu
        Density of solid tissue (default 30 HU) or of pure ground glass (default -600 HU). The ground glass round a
        solid core has -600 HU.
    spiculation
        0 for a ball, up to 1 for lobes and spicules.
    seed
        Seed of lobes, spicules and noise.
    through_vessels
        Whether a nodule may overlap vessels; a solid one replaces them.

    Returns
    -------
    InsertedNodule
        The CT with the nodule, and the truth.

    Raises
    ------
    UsageError
        ``insert.outside-ct``, ``insert.outside-lung``, ``insert.in-airway``, ``insert.airway-wall``, ``insert.wall`` or
        ``insert.vessel`` for a position that is refused; ``insert.not-hu``; ``insert.core`` for a core that is not
        smaller than the nodule.
    NoResultError
        ``insert.no-edges`` or ``insert.no-noise``, if the blur or the noise cannot be measured near the position.

    Examples
    --------
    >>> import carina
    >>> phantom = carina.generate_phantom(spacing_mm=1.5, generations=4)
    >>> airways = carina.find_airways(phantom.volume)
    >>> place = carina.training.free_nodule_position(phantom.volume, airways, diameter_mm=8.0)
    >>> made = carina.insert_nodule(phantom.volume, airways, place, diameter_mm=8.0)
    >>> [note.code for note in made.volume.source.notes]
    ['import.inserted']
    """
    _check_hu(volume)
    centre = np.asarray(centre_lps, dtype=np.float64)
    core_mm = None
    if kind == "part-solid":
        core_mm = CORE_SHARE * diameter_mm if core_diameter_mm is None else core_diameter_mm
    if (core_diameter_mm is not None and kind != "part-solid") or (core_mm is not None and core_mm >= diameter_mm):
        raise UsageError(
            f"core_diameter_mm: expected a core smaller than {diameter_mm:g} mm, for a part-solid nodule; found "
            f"{core_diameter_mm:g} mm for a {kind} nodule",
            code="insert.core",
        )
    shape = NoduleShape.of_volume(diameter_mm, spiculation, seed)
    place = _check_place(volume, airways, centre, shape, through_vessels=through_vessels)
    near, wider = (volume.hu_zyx[_box_part(volume, centre, half)] for half in (SURROUNDINGS_MM, WIDER_MM))
    texture = measured_texture(near, volume.spacing_mm, wider_zyx=wider)
    density = density_hu if density_hu is not None else (GLASS_HU if kind == "ground-glass" else SOLID_HU)
    values = volume.hu_zyx.copy()
    if kind != "solid":
        glass = density if kind == "ground-glass" else GLASS_HU
        part, share = voxel_shares(volume, centre, shape, texture)
        values[part] = _rounded(values[part] + share * (glass - place.lung_hu))
    if kind != "ground-glass":
        core = shape if core_mm is None else NoduleShape.of_volume(core_mm, spiculation, seed)
        part, share = voxel_shares(volume, centre, core, texture)
        # The old noise fades with the lung that is replaced; new noise restores its variance.
        grains = texture.noise(share.shape, seed) * np.sqrt(np.clip(1.0 - (1.0 - share) ** 2, 0.0, 1.0))
        values[part] = _rounded((1.0 - share) * values[part] + share * density + grains)
    exact = (float(centre[0]), float(centre[1]), float(centre[2]))
    source = replace(
        with_inserted(volume.source, (structure_text(kind, diameter_mm, exact),)), series=None, other_series=()
    )
    return InsertedNodule(
        Volume(values, volume.lps_from_ijk, source=source),
        kind,
        exact,
        float(diameter_mm),
        math.pi / 6.0 * diameter_mm**3,
        core_mm,
        float(density),
        float(spiculation),
        int(seed),
        place.lung_hu,
        texture,
        place.has_vessels,
    )


@check_arguments(**_CHECKS)
def free_nodule_position(
    volume: Volume,
    airways: Airways,
    *,
    diameter_mm: float = 10.0,
    spiculation: float = 0.0,
    seed: int = 0,
    through_vessels: bool = False,
) -> NDArray[np.float64]:
    """Return a random position in the lung at which :func:`insert_nodule` accepts a nodule.

    Parameters
    ----------
    volume, airways, diameter_mm, spiculation, seed, through_vessels
        As for :func:`insert_nodule`; the seed also selects the position.

    Returns
    -------
    numpy.ndarray
        (3,) LPS mm.

    Raises
    ------
    UsageError
        ``insert.not-hu``.
    NoResultError
        ``insert.no-place``: no position was found.
    """
    _check_hu(volume)
    shape = NoduleShape.of_volume(diameter_mm, spiculation, seed)
    rng = np.random.default_rng([seed, 47])
    size = np.array(volume.shape_zyx)
    tree = np.concatenate([branch.points for branch in airways.tree.branches])
    low, high = tree.min(axis=0) - 40.0, tree.max(axis=0) + 40.0
    for _ in range(MAX_TRIES):
        k, j, i = (int(n) for n in rng.integers(size))
        centre = volume.to_lps(np.array([i, j, k], dtype=np.float64))
        hu = int(volume.hu_zyx[k, j, i])
        if not -980 < hu < -700 or not ((centre > low) & (centre < high)).all():
            continue
        # Most random positions of a large nodule contain too much tissue. This trial rejects them a thousand times
        # faster than the whole check.
        trial = shape.radius_mm * rng.uniform(-1.0, 1.0, (TRIAL_POINTS, 3))
        trial = np.rint(volume.to_ijk(centre + trial[np.linalg.norm(trial, axis=1) <= shape.radius_mm])).astype(int)
        if (trial < 0).any() or (trial >= size[::-1]).any():
            continue
        if float((volume.hu_zyx[trial[:, 2], trial[:, 1], trial[:, 0]] > SOFT_HU).mean()) > TRIAL_SOFT_SHARE:
            continue
        try:
            _check_place(volume, airways, centre, shape, through_vessels=through_vessels)
        except UsageError:
            continue
        return centre
    raise NoResultError(
        f"no free position was found in the lung for a nodule of {diameter_mm:g} mm; try a smaller one, or allow "
        "vessels in it",
        code="insert.no-place",
    )


@dataclass(frozen=True, slots=True)
class _Place:
    lung_hu: float
    has_vessels: bool


def _check_hu(volume: Volume) -> None:
    if not volume.is_hu:
        raise UsageError(
            f"a nodule can only be inserted into a CT in HU; this volume is not: {volume.not_hu_reason}",
            code="insert.not-hu",
        )


def _check_place(
    volume: Volume, airways: Airways, centre: NDArray[np.float64], shape: NoduleShape, *, through_vessels: bool
) -> _Place:
    """Return the density of the lung at a position; raise UsageError if a nodule is refused there."""

    def refuse(code: str, problem: str, remedy: str = "choose another position or a smaller nodule") -> UsageError:
        where = ", ".join(f"{v:.1f}" for v in centre)
        return UsageError(f"inserting a nodule at {where}: {problem}; {remedy}", code=f"insert.{code}")

    reach = shape.reach_mm
    corners = centre + np.array(np.meshgrid(*[(-reach - 1.0, reach + 1.0)] * 3)).reshape(3, -1).T
    if not all(volume.contains_lps(corner) for corner in corners):
        raise refuse("outside-ct", "the nodule would reach beyond the scan")
    # The points are centres of voxels of the lumen, which reaches half a voxel farther.
    margin = AIRWAY_WALL_MM + 0.5 * min(volume.spacing_mm)
    lumen = _lumen_points(volume, airways, centre, reach + margin + 1.0)
    axes = np.concatenate([branch.points for branch in airways.tree.branches])
    axes = axes[np.linalg.norm(axes - centre, axis=1) < reach + margin + 1.0]
    air = np.concatenate([lumen, axes])
    if shape.contains(air - centre).any():
        raise refuse("in-airway", "the nodule would be in the lumen of an airway")
    if shape.contains(air - centre, margin_mm=margin).any():
        raise refuse("airway-wall", "the nodule would be in the wall of an airway")
    box = Box.around(volume, centre, reach + 3.0 * THICK_MM)
    soft = smoothed(box.hu_zyx, 0.5 / box.step_mm)
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in soft.shape), indexing="ij")[::-1], axis=-1) * box.step_mm
    offsets = grid + box.lps_from_ijk[:3, 3] - centre
    inside = shape.contains(offsets)
    if float(np.median(soft[inside])) < BARE_AIR_HU or is_outside_body(volume, centre):
        raise refuse("outside-lung", "the position is in air, not in lung")
    tissue = (soft > SOFT_HU) | ~box.known
    deep = ball_distance(tissue, box.step_mm, THICK_MM + box.step_mm) >= THICK_MM - 0.5 * box.step_mm
    thick = distance_from(deep, box.step_mm, THICK_MM + 1.0) <= THICK_MM if deep.any() else np.zeros_like(tissue)
    thick = (thick & tissue) | deep
    if float((inside & tissue).sum()) > 0.5 * float(inside.sum()):
        raise refuse("outside-lung", "most of the position is soft tissue, not lung")
    if (shape.contains(offsets, margin_mm=WALL_MARGIN_MM) & thick).any():
        raise refuse("wall", "the nodule would touch the chest wall, the mediastinum or the diaphragm")
    vessels = float((inside & tissue).sum()) * box.step_mm**3
    if vessels >= VESSEL_MM3 and not through_vessels:
        raise refuse(
            "vessel",
            f"the nodule would overlap a vessel or another structure of soft tissue ({vessels:.0f} mm3)",
            "choose another position, or allow vessels (through_vessels, --through-vessels)",
        )
    near = (shape.contains(offsets, margin_mm=4.0)) & ~tissue
    return _Place(lung_median_hu(soft[near & (soft < SOFT_HU)]), vessels >= VESSEL_MM3)


def _lumen_points(
    volume: Volume, airways: Airways, centre: NDArray[np.float64], reach_mm: float
) -> NDArray[np.float64]:
    """Return the voxels of the lumen near a point, (n, 3) LPS mm."""
    part = _box_part(volume, centre, reach_mm)
    at = np.argwhere(airways.lumen_zyx[part] > 0)[:, ::-1] + [part[2].start, part[1].start, part[0].start]
    return volume.to_lps(at.astype(np.float64)).reshape(-1, 3)


def _box_part(volume: Volume, centre: NDArray[np.float64], reach_mm: float) -> tuple[slice, slice, slice]:
    """Return the slices of the voxels within a distance of a point along each axis of the grid."""
    ijk = volume.to_ijk(centre)
    found = []
    for axis in (2, 1, 0):
        half = reach_mm / volume.spacing_mm[axis]
        size = volume.shape_zyx[2 - axis]
        found.append(slice(max(0, math.floor(ijk[axis] - half)), min(size, math.ceil(ijk[axis] + half) + 1)))
    return found[0], found[1], found[2]


def voxel_shares(
    volume: Volume, centre: NDArray[np.float64], shape: NoduleShape, texture: CtTexture
) -> tuple[tuple[slice, slice, slice], NDArray[np.float64]]:
    """Return the part of a CT that a shape changes, and the share of the shape in each of its voxels after the blur.

    The sum of the shares times the volume of a voxel is the volume of the shape.
    """
    wide = [math.hypot(sigma, SURROUND_MM if texture.gain > 0.0 and n < 2 else 0.0) for n, sigma in
            enumerate(texture.sigma_mm)]  # fmt: skip
    part = _box_part(volume, centre, shape.reach_mm + 4.0 * max(wide) + 1.0)
    # Cells divide voxels, so that a voxel axis is a small matrix of weights.
    per_voxel = [max(1, math.ceil(spacing / CELL_MM)) for spacing in volume.spacing_mm]
    axes = []
    for axis in range(3):
        one = part[2 - axis]
        count = (one.stop - one.start) * per_voxel[axis]
        axes.append(one.start - 0.5 + (np.arange(count) + 0.5) / per_voxel[axis])
    inside = np.empty(tuple(len(axis) for axis in axes[::-1]), dtype=np.float32)
    j, i = np.meshgrid(axes[1], axes[0], indexing="ij")
    for n, k in enumerate(axes[2]):
        points = volume.to_lps(np.stack([i, j, np.full_like(i, k)], axis=-1))
        inside[n] = shape.contains(points - centre)

    def blurred(sigmas: tuple[float, float, float]) -> NDArray[np.float64]:
        found = inside.astype(np.float64)
        for axis in range(3):
            one = part[2 - axis]
            at = np.arange(one.start, one.stop, dtype=np.float64)
            off = (at[:, None] - axes[axis][None, :]) * volume.spacing_mm[axis]
            weights = np.exp(-0.5 * (off / sigmas[axis]) ** 2)
            # A cell's weights of all voxels sum to one, so that no volume is lost between the samples.
            weights /= np.maximum(weights.sum(axis=0, keepdims=True), 1e-12)
            found = np.moveaxis(np.tensordot(weights, found, axes=(1, 2 - axis)), 0, 2 - axis)
        return found / float(np.prod(per_voxel))

    si, sj, sk = texture.sigma_mm
    share = blurred((si, sj, sk))
    if texture.gain > 0.0:
        surround = (math.hypot(si, SURROUND_MM), math.hypot(sj, SURROUND_MM), sk)
        share = share + texture.gain * (share - blurred(surround))
    return part, share


def _rounded(values: NDArray[np.floating[Any]]) -> NDArray[np.int16]:
    rounded: NDArray[np.int16] = np.clip(np.rint(values), -32768, 32767).astype(np.int16)
    return rounded
