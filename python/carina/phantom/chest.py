"""The phantom as volume and truth: generated chests, their files, and the demo case in the cache."""

from __future__ import annotations

import contextlib
import hashlib
import json
import logging
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from carina import _core
from carina.argument_checks import (
    array_of,
    check_arguments,
    choice,
    each,
    file_path,
    flag,
    function,
    instance,
    number_from,
    whole_from,
)
from carina.config import load_settings
from carina.disk import Draft, make_folder
from carina.display.progress import ProgressChoice, progress_function, shows_progress
from carina.errors import CancelledError, UsageError
from carina.phantom.airway_lesions import LESIONS, add_lesion
from carina.phantom.leaning_trachea import MAX_LEAN_DEG, lean_chest, moved_mm
from carina.volume import Volume, VolumeSource, write_grid_to

__all__ = ["Phantom", "demo_phantom", "generate_phantom", "lumen_distance_at", "write_phantom"]

Scalar = TypeVar("Scalar", bound=np.generic)

# Increment if the same options give another chest (a test pins their checksum): cached demos are then generated again.
GENERATOR_VERSION = 2
DEMO_OPTIONS: dict[str, Any] = {"seed": 0, "spacing_mm": 0.9, "generations": 7, "nodule": True}

VARIANTS = ("tracheal-bronchus", "subsuperior", "absent-rb7", "trifurcations", "left-isomerism", "published")
"""Values of the argument ``variant``."""

ABANDONED_S = 3600.0
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class Phantom:
    """Generated chest CT and its ground truth."""

    volume: Volume
    """The CT, in HU."""
    lumen_zyx: NDArray[np.uint8]
    """``(nz, ny, nx)``: 1 in voxels whose *centre* lies in an airway's lumen."""
    truth: dict[str, Any]
    """Document of ``truth.json``: an exact ``carina-tree`` (LPS, mm), with ``nodule`` and ``stenosis`` or None.

    It has ``cricoid_lps``, ``tube``, ``lean_deg``, ``variants`` and ``lesion`` if they were requested.
    """
    lumen_distance_mm: NDArray[np.float32] | None = None
    """``(nz, ny, nx)`` signed distance to the lumen's surface, mm, negative inside; None unless requested.

    It is at least 5 where no airway is near.
    """
    upper_airway_zyx: NDArray[np.uint8] | None = None
    """``(nz, ny, nx)``: 1 in voxels whose centre lies in the air above the cricoid; None without a neck.

    This air (larynx and throat) is not part of the tree.
    """

    def __repr__(self) -> str:
        """Return a short description for the interpreter."""
        return f"Phantom({self.volume!r}, branches={len(self.truth['branches'])})"


def _check_lean(where: str, name: str, value: object) -> None:
    """Reject anything but two angles within the limits of a leaning trachea."""
    each(number_from(-MAX_LEAN_DEG, MAX_LEAN_DEG, unit="degrees"), least=2, most=2)(where, name, value)


def _check_spacing(where: str, name: str, value: object) -> None:
    """Reject anything but one number or three numbers from 0.3 to 10 mm."""
    one = number_from(0.3, 10.0, unit="mm")
    (each(one, least=3, most=3) if isinstance(value, list | tuple | np.ndarray) else one)(where, name, value)


@shows_progress
@check_arguments(
    seed=whole_from(0, 2**64 - 1),
    spacing_mm=_check_spacing,
    generations=whole_from(3, 9),
    stenosis=flag,
    nodule=flag,
    noise_hu=number_from(0.0, 200.0, unit="HU"),
    neck=flag,
    lean_deg=_check_lean,
    tube=choice("endotracheal", "tracheostomy", optional=True),
    resected=choice("RUL", "RML", "RLL", "LUL", "LLL", optional=True),
    variant=choice(*VARIANTS, optional=True),
    lesion=choice(*LESIONS, optional=True),
    box_lps=array_of(2, 3, optional=True, what="two corners of three finite numbers in mm (LPS)"),
    with_distance=flag,
    cancel=function,
)
def generate_phantom(
    *,
    seed: int = 0,
    spacing_mm: float | Sequence[float] = 0.8,
    generations: int = 6,
    stenosis: bool = False,
    nodule: bool = False,
    noise_hu: float = 20.0,
    neck: bool = False,
    lean_deg: Sequence[float] = (0.0, 0.0),
    tube: str | None = None,
    resected: str | None = None,
    variant: str | None = None,
    lesion: str | None = None,
    box_lps: Sequence[Sequence[float]] | None = None,
    with_distance: bool = False,
    progress: ProgressChoice = None,
    cancel: Callable[[], bool] | None = None,
) -> Phantom:
    """Generate a chest CT with ground truth: body, lungs, vessels and an airway tree with named segments.

    The carina lies at the origin of LPS space; the trachea's first point lies in the top slice. The same arguments give
    the same voxels, on any machine and any number of cores.

    Parameters
    ----------
    seed
        Seed of the anatomy: directions, sizes, patterns of division (upper and lower lobes), noise.
    spacing_mm
        Distance of voxel centres, one number or ``(x, y, z)``; 0.3 to 10 mm. A thick slice averages over its thickness.
    generations
        Airways divide up to this generation (trachea 0), 3 to 9; named segments always exist.
    stenosis
        Whether the left main or the intermediate bronchus is narrowed to less than half its diameter.
    nodule
        Whether a round nodule of 5 to 10 mm radius lies near the end of an airway.
    noise_hu
        Standard deviation of the noise, 0 to 200 HU; correlated in plane.
    neck
        Whether the volume continues above the chest, to 195 mm above the carina: larynx with the vocal cords, piriform
        sinuses, throat and the surrounding neck. The trachea then ends at the lower border of the cricoid,
        ``truth["cricoid_lps"]``, 104 to 126 mm above the carina; the air above it is ``upper_airway_zyx`` and not part
        of the tree.
    lean_deg
        Angles, -35 to 35 degrees, by which all anatomy above the carina leans to the patient's left and to the back:
        the trachea with the neck, as in a patient with scoliosis. The slices above the carina are shifted in their
        planes; the chest below stays the same. Not together with a nodule or ``with_distance``.
    tube
        Tube in the trachea: "endotracheal" (with a neck through the larynx, with its cuff and fluid on it) or
        "tracheostomy" (through the front of the neck, open to the air outside; it needs the neck). Its tip is in
        ``truth["tube"]``; the truth of the lumen is the whole trachea, including the tube.
    resected
        Lobe that is missing, as after a lobectomy: RUL, RML, RLL, LUL or LLL. A stump of its bronchus remains, a branch
        without a name; neighbouring airways are shifted slightly into the free space.
    variant
        Anatomical variant of the airways, not together with a tube or a resected lobe: ``tracheal-bronchus`` (RB1
        arises from the trachea), ``subsuperior`` (RB*), ``absent-rb7``, ``trifurcations`` (of RUL and of the left basal
        trunk; all right basal segments arise together), ``left-isomerism`` (both lungs have the pattern of the left
        one), or ``published``: each variant is drawn by the seed with its published frequency (docs/algorithms.md).
        ``truth["variants"]`` lists them. None: no such variant; the divisions of the lobes vary by seed.
    lesion
        Lesion in one bronchus, with position and size by seed: ``tumour`` (inside the lumen, on its wall), ``mucus``
        (7 to 12 mm of a segmental bronchus, at least .7 of its height), ``bleeding`` (a pool of blood) or
        ``foreign-body`` (as dense as bone). ``truth["lesion"]`` describes it; ``lumen_zyx`` is without it, and the tree
        is that of the bronchus without it. Not together with a lean or ``with_distance``.
    box_lps
        ``((x, y, z), (x, y, z))`` lower and upper corner of the part to generate, in mm. Default: the whole chest. The
        truth always contains the whole tree.
    with_distance
        Whether to return the signed distance to the lumen (4 bytes per voxel).
    progress
        False, True or ``f(what, fraction)``. True and None show a bar in a terminal or a notebook. The fraction is None
        where it is unknown.
    cancel
        Function that is called often; the work stops when it returns True.

    Returns
    -------
    Phantom
        The volume, the lumen and the truth.

    Raises
    ------
    UsageError
        If an option is out of range.
    CancelledError
        If ``cancel`` returned True.

    Examples
    --------
    >>> made = generate_phantom(spacing_mm=4.0, generations=3)
    >>> made.truth["branches"][0]["name"]
    'Trachea'
    """
    spacing = (float(spacing_mm),) * 3 if isinstance(spacing_mm, int | float) else tuple(float(s) for s in spacing_mm)
    if len(spacing) != 3:
        raise UsageError(
            f"spacing: expected one number or three (x, y, z); found {len(spacing)}", code="phantom.option"
        )
    if not 0 <= seed < 2**64:
        raise UsageError(f"seed: expected a whole number from 0 to 2^64 - 1; found {seed}", code="phantom.option")
    if generations < 0:
        raise UsageError(
            f"generations: expected a whole number from 3 to 9; found {generations}", code="phantom.option"
        )
    box = None
    if box_lps is not None:
        corners = np.asarray(box_lps, dtype=np.float64)
        if corners.shape != (2, 3):
            msg = f"box: expected two corners of three numbers; found shape {corners.shape}"
            raise UsageError(msg, code="phantom.option")
        box = corners.tolist()

    leans = any(lean_deg)
    if leans and (nodule or with_distance):
        what = "nodule" if nodule else "distance"
        raise UsageError(
            f"lean: expected a chest without a {what}; found both; leave one of them out", code="phantom.option"
        )
    if lesion is not None and (leans or with_distance):
        what = "a lean" if leans else "distances"
        raise UsageError(
            f"lesion: expected a chest without {what}; found both; leave one of them out", code="phantom.option"
        )
    # Parts of the neck that are shifted into the box come from outside the box.
    beside: tuple[int, ...] = (0, 0)
    if leans and box is not None:
        most_mm = moved_mm(lean_deg, np.array([box[1][2]]))[0]
        beside = tuple(int(np.ceil(abs(most_mm[a]) / spacing[a])) + 2 for a in range(2))
        for a in range(2):
            box[0][a] -= beside[a] * spacing[a]
            box[1][a] += beside[a] * spacing[a]

    report = progress_function(progress)

    def proceed(fraction: float) -> bool:
        if cancel is not None and cancel():
            raise CancelledError("stopped while generating the phantom")
        if report is not None:
            report("generating the phantom", fraction)
        return True

    made = _core.generate_chest(
        seed,
        spacing,
        int(generations),
        stenosis,
        nodule,
        float(noise_hu),
        neck,
        tube,
        resected,
        variant,
        box,
        with_distance or leans,
        proceed,
    )
    if leans:
        lean_chest(made, lean_deg, beside)
    if lesion is not None:
        made["lesion"] = add_lesion(made, lesion, seed)
    branches = [
        {
            "id": b["id"],
            "parent": b["parent"],
            "children": b["children"],
            "generation": b["generation"],
            "name": b["name"],
            "kind": "tracked",
            "points": b["points"],
            "radius": b["radius"],
            "cost": None,
            "confidence": 1.0,
            "wall_mm": b["wall_mm"],
        }
        for b in made["branches"]
    ]
    truth = {
        "format": "carina-tree",
        "version": 1,
        "space": "LPS",
        "unit": "mm",
        "root": 0,
        "branches": branches,
        "nodule": made.get("nodule"),
        "stenosis": made.get("stenosis"),
    }
    truth |= {key: made[key] for key in ("cricoid_lps", "tube", "lean_deg", "variants", "lesion") if key in made}
    truth = in_one_spelling(truth)
    return Phantom(
        volume=_volume(made["hu_zyx"], np.array(made["lps_from_ijk"]), seed),
        lumen_zyx=_frozen(made["lumen_zyx"]),
        truth=truth,
        lumen_distance_mm=_frozen(made["lumen_distance_mm"]) if with_distance else None,
        upper_airway_zyx=_frozen(made["upper_airway_zyx"]) if neck else None,
    )


def lumen_distance_at(
    points_lps: ArrayLike, *, seed: int = 0, generations: int = 6, stenosis: bool = False, neck: bool = False
) -> NDArray[np.float64]:
    """Return the exact distance to the lumen of a phantom at any points, without voxels.

    Parameters
    ----------
    points_lps
        (n, 3) LPS mm.
    seed, generations, stenosis, neck
        As for :func:`generate_phantom`.

    Returns
    -------
    numpy.ndarray
        (n,) mm, negative in the lumen, exact near the surface; 5 where no airway is near.

    Examples
    --------
    >>> made = generate_phantom(spacing_mm=4.0, generations=3)
    >>> bool(lumen_distance_at([made.truth["branches"][0]["points"][4]], generations=3)[0] < -5.0)
    True
    """
    points = np.atleast_2d(np.ascontiguousarray(points_lps, dtype=np.float64))
    return _core.chest_lumen_distances(seed, generations, stenosis, neck, points)


@check_arguments(phantom=instance(Phantom, "make one with carina.generate_phantom"), directory=file_path())
def write_phantom(phantom: Phantom, directory: str | os.PathLike[str]) -> list[Path]:
    """Write ``ct.nii.gz``, ``lumen.nii.gz`` and ``truth.json`` into a folder, which is created if missing.

    A phantom with a neck also gives ``upper-airway.nii.gz``: the air above the cricoid. An MR picture is
    ``mr.nii.gz`` instead of the CT.

    Parameters
    ----------
    phantom
        Phantom to write.
    directory
        Folder. Files of these names are replaced, each in one step, so that a reader never sees an incomplete file.

    Returns
    -------
    list of Path
        Paths of the files. NIfTI is RAS by convention; the LPS grid is converted into it.

    Examples
    --------
    >>> import carina
    >>> phantom = carina.generate_phantom(spacing_mm=3.0, generations=3)
    >>> [path.name for path in carina.write_phantom(phantom, "phantom")]
    ['ct.nii.gz', 'lumen.nii.gz', 'truth.json']
    """
    folder = make_folder(directory, what="the phantom")
    matrix = phantom.volume.lps_from_ijk
    scan, about = ("ct.nii.gz", "the CT") if phantom.volume.is_hu else ("mr.nii.gz", "the MR picture")
    # Compression level 1: a higher level takes longer and does not make noise smaller.
    parts: tuple[tuple[str, str, Callable[[BinaryIO], object]], ...] = (
        (scan, about, lambda file: _write_nifti(file, phantom.volume.hu_zyx, matrix, about)),
        ("lumen.nii.gz", "the lumen", lambda file: _write_nifti(file, phantom.lumen_zyx, matrix, "the lumen")),
        ("truth.json", "the ground truth", lambda file: file.write(_json(phantom.truth).encode())),
    )
    upper = phantom.upper_airway_zyx
    if upper is not None:
        name, what = "upper-airway.nii.gz", "the upper airway"
        parts = (*parts[:2], (name, what, lambda file: _write_nifti(file, upper, matrix, what)), parts[2])
    drafts: list[Draft] = []
    try:
        # All files are written before the first replaces its predecessor: a full disk leaves the former files.
        for name, what, write in parts:
            draft = Draft(folder / name, what=what)
            drafts.append(draft)
            try:
                write(draft.file)
                draft.file.flush()
                os.fsync(draft.file.fileno())
            except OSError as error:
                draft.discard()
                raise draft.disk_error(error) from error
        for draft in drafts:
            draft.commit()
    finally:
        for draft in drafts:
            draft.discard()
    return [folder / name for name, _, _ in parts]


def _write_nifti(file: BinaryIO, values: NDArray[Any], lps_from_ijk: NDArray[np.float64], what: str) -> None:
    write_grid_to(file, ".nii.gz", values, lps_from_ijk, what=what, level=1)


@shows_progress
def demo_phantom(
    *,
    cache_dir: Path | None = None,
    progress: ProgressChoice = None,
    cancel: Callable[[], bool] | None = None,
) -> Phantom:
    """Return the demo case: a chest with a nodule, generated once and then read from the cache.

    Parameters
    ----------
    cache_dir
        Cache folder; default: the user's. Damaged files are generated again. A cache that cannot be written costs only
        time.
    progress, cancel
        As for :func:`generate_phantom`.

    Returns
    -------
    Phantom
        The demo.
    """
    root = load_settings().cache_dir if cache_dir is None else cache_dir
    key = hashlib.sha256(_json([GENERATOR_VERSION, DEMO_OPTIONS]).encode()).hexdigest()[:16]
    folder = root / f"phantom-{key}"
    found = _read_cached(folder)
    if found is not None:
        return found
    made = generate_phantom(**DEMO_OPTIONS, progress=progress, cancel=cancel)
    try:
        _write_cached(made, folder)
    except OSError as error:
        _log.debug("the demo phantom could not be cached: %s", type(error).__name__)
    return made


def in_one_spelling(truth: dict[str, Any]) -> dict[str, Any]:
    """Return the document of ``truth.json`` with ``centre_lps`` where earlier versions wrote ``center_lps``.

    Examples
    --------
    >>> in_one_spelling({"nodule": {"center_lps": [1.0, 2.0, 3.0], "radius_mm": 5.0}, "stenosis": None})["nodule"]
    {'centre_lps': [1.0, 2.0, 3.0], 'radius_mm': 5.0}
    """
    made = dict(truth)
    for part in ("nodule", "stenosis"):
        found = made.get(part)
        if isinstance(found, Mapping) and "center_lps" in found:
            made[part] = {"centre_lps" if key == "center_lps" else key: value for key, value in found.items()}
    return made


def _volume(hu_zyx: NDArray[np.int16], lps_from_ijk: NDArray[np.float64], seed: int) -> Volume:
    source = VolumeSource(format="phantom", title=f"Phantom {seed}: synthetic, not a patient")
    return Volume(hu_zyx, lps_from_ijk, source=source)


def _frozen(values: NDArray[Scalar]) -> NDArray[Scalar]:
    values.flags.writeable = False
    return values


def _json(document: object) -> str:
    # Python writes each float64 with the digits that restore it, so points survive bit for bit.
    return json.dumps(document, allow_nan=False, separators=(",", ":"))


def _write_cached(phantom: Phantom, folder: Path) -> None:
    """Write into a temporary folder and rename it, so that no reader sees an incomplete phantom."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    _sweep_drafts(folder.parent)
    scratch = Path(tempfile.mkdtemp(dir=folder.parent, prefix=".phantom-"))
    try:
        np.save(scratch / "ct.npy", phantom.volume.hu_zyx, allow_pickle=False)
        np.save(scratch / "lumen.npy", np.packbits(phantom.lumen_zyx), allow_pickle=False)
        rest = {"truth": phantom.truth, "lps_from_ijk": phantom.volume.lps_from_ijk.tolist()}
        (scratch / "truth.json").write_text(_json(rest), encoding="utf-8")
        sums = {name: _checksum(scratch / name) for name in ("ct.npy", "lumen.npy", "truth.json")}
        (scratch / "sums.json").write_text(_json(sums), encoding="utf-8")
        if folder.exists():
            shutil.rmtree(folder)
        scratch.replace(folder)
        for old in folder.parent.glob("phantom-*"):
            if old != folder:
                shutil.rmtree(old, ignore_errors=True)
    finally:
        with contextlib.suppress(OSError):
            shutil.rmtree(scratch)


def _sweep_drafts(root: Path) -> None:
    """Delete temporary folders of killed Carina processes: those older than an hour, since no phantom takes so long."""
    for draft in root.glob(".phantom-*"):
        with contextlib.suppress(OSError):
            if time.time() - draft.lstat().st_mtime > ABANDONED_S:
                shutil.rmtree(draft)


def _read_cached(folder: Path) -> Phantom | None:
    """Return the cached phantom; None if there is none or its content was changed."""
    try:
        sums = json.loads((folder / "sums.json").read_text(encoding="utf-8"))
        for name in ("ct.npy", "lumen.npy", "truth.json"):
            if _checksum(folder / name) != sums[name]:
                return None
        hu_zyx = np.load(folder / "ct.npy", allow_pickle=False)
        bits = np.load(folder / "lumen.npy", allow_pickle=False)
        rest = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
        lumen = np.unpackbits(bits, count=hu_zyx.size).reshape(hu_zyx.shape)
        return Phantom(
            volume=_volume(hu_zyx, np.array(rest["lps_from_ijk"]), DEMO_OPTIONS["seed"]),
            lumen_zyx=_frozen(lumen),
            truth=in_one_spelling(rest["truth"]),
        )
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _checksum(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
