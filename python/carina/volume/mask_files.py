"""Function ``open_mask``, which reads a segmentation and places it on a CT's grid by its geometry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from msgspec import Meta
from numpy.typing import DTypeLike, NDArray

from carina.argument_checks import check_arguments, file_path, flag, function, instance, whole_from
from carina.display import one_line
from carina.display.progress import ProgressChoice, progress_function, shows_progress
from carina.errors import VolumeImportError
from carina.value import FrozenValue, Words
from carina.volume.dicom_signature import looks_like_dicom
from carina.volume.grid_files import read_grid_array
from carina.volume.grid_headers import GRID_FORMATS, sniff_format
from carina.volume.io_errors import guarded
from carina.volume.model import Volume
from carina.volume.progress import Watch

# Tools number structures from 1. A larger number would change in a browser, or by rounding to float32.
_LARGEST_LABEL = 2**24
_SAMPLED = 10_000
# Labels 0 to 25 stored as scaled bytes deviate by up to 0.05.
_MAX_FLOAT_LABEL_ERROR = 0.05
_MAX_FLOAT_LABELS = 100_000
# Tolerance in voxels: float32 headers are exact to about 1e-4 mm, other grids differ by a large part of a voxel.
_SAME_VOXEL = 0.05


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class Mask:
    """Mask of a structure on the grid of a CT, with notes."""

    inside_zyx: NDArray[np.uint8]
    """(nz, ny, nx) uint8 on the grid of the CT, 1 inside the structure, read-only."""
    notes: tuple[str, ...] = ()
    """Notes on the placement of the mask and on doubts about its file."""

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        """Return ``inside_zyx`` for ``numpy.asarray``; the array is copied only for another type or on request."""
        return np.array(self.inside_zyx, dtype=dtype, copy=copy)


class MaskLabel(FrozenValue, frozen=True):
    """A structure in an imported mask."""

    number: Annotated[int, Meta(ge=-(2**53), le=2**53)]
    """Number of the structure in the file (or of its DICOM segment)."""
    name: Words | None
    """Name of the structure in the file; None if it has no name."""
    volume_ml: float


class MaskLabelError(VolumeImportError):
    """Error for a mask with several structures of which none was chosen."""

    code = "import.mask-label"

    def __init__(self, message: str, labels: tuple[MaskLabel, ...]) -> None:
        super().__init__(message)
        self.labels = labels


class MaskGridError(VolumeImportError):
    """Error for a mask on another grid than the scan's; the mask can be resampled."""

    code = "import.mask-grid"

    def __init__(self, message: str, *, expected: str, found: str, share_inside: float) -> None:
        super().__init__(message)
        self.expected = expected
        """Description of the CT's grid, which the mask should have."""
        self.found = found
        """Description of the grid that the mask's file has."""
        self.share_inside = share_inside
        """Share of the structure that is inside the scan, 0 to 1."""


@shows_progress
@check_arguments(
    path=file_path(),
    volume=instance(Volume, "open a volume with carina.open_volume"),
    label=whole_from(-(2**31), 2**31 - 1, optional=True),
    resample=flag,
    cancel=function,
)
def open_mask(
    path: str | Path,
    volume: Volume,
    *,
    label: int | None = None,
    resample: bool = False,
    progress: ProgressChoice = None,
    cancel: Callable[[], bool] | None = None,
) -> Mask:
    """Open a mask (NIfTI, NRRD, MetaImage or DICOM SEG) and place it on a volume's grid.

    The axes may be flipped or exchanged and the mask may cover a part of the scan, if its voxels coincide with voxels
    of the scan; the placement is then exact. Any other mask is on another grid.

    Parameters
    ----------
    path
        The mask's file.
    volume
        The CT that the mask belongs to.
    label
        Number (or DICOM segment) of the structure; needed only if the mask contains several.
    resample
        Accept a mask on another grid: each voxel of the CT gets the value of the mask's nearest voxel.
    progress
        False, True or ``f(what, fraction)``. True or None shows a progress bar in a terminal or a notebook. The
        fraction is None where it is unknown.
    cancel
        Called often; the work stops when it returns True.

    Returns
    -------
    Mask
        1 inside, 0 outside.

    Raises
    ------
    MaskGridError
        If the mask is on another grid; the message states the difference.
    MaskLabelError
        If the mask contains several structures and ``label`` is not the number of one of them.
    VolumeImportError
        If the file is not a mask or is empty, or if the mask is outside the scan.
    CancelledError
        If ``cancel()`` returned true.

    Examples
    --------
    >>> import carina
    >>> phantom = carina.generate_phantom(spacing_mm=3.0, generations=3)
    >>> ct, lumen, _ = carina.write_phantom(phantom, "phantom")
    >>> mask = carina.open_mask(lumen, phantom.volume)
    >>> bool((mask.inside_zyx == phantom.lumen_zyx).all())
    True
    """
    watch = Watch(progress_function(progress), cancel)

    def read(where: Path) -> Mask:
        found = _labels(where, volume, watch)
        voxel_ml = abs(float(np.linalg.det(found.lps_from_mask[:3, :3]))) / 1000.0
        chosen = _selected_label(where, found, label, voxel_ml)
        inside, mask_notes = found.inside(chosen)
        placed = _place_on_grid(where, inside, found.lps_from_mask, volume, resample=resample, watch=watch)
        notes = tuple(f"the segmentation: {words}" for words in (*found.notes, *mask_notes))
        return replace(placed, notes=(*notes, *placed.notes))

    return guarded(Path(path).expanduser(), read)


@dataclass(frozen=True, slots=True, eq=False)
class _Labels:
    """The structures in a mask file, with their names, sizes and voxels."""

    num_voxels: dict[int, int]
    """Number of voxels of each structure that is not empty."""
    inside: Callable[[int], tuple[NDArray[np.bool_], tuple[str, ...]]]
    """Returns the voxels ``[z, y, x]`` of one structure, and notes about it."""
    lps_from_mask: NDArray[np.float64]
    names: dict[int, str]
    """Names of the structures, if the file contains names."""
    notes: tuple[str, ...]


def _labels(path: Path, volume: Volume, watch: Watch) -> _Labels:
    """Return the structures in a file with their grid."""
    if not path.exists():
        msg = f"reading the segmentation {path.name}: there is no such file; check the path {path}"
        raise VolumeImportError(msg, code="import.not-found")
    if path.is_file() and looks_like_dicom(path):
        from carina.volume.dicom_segmentation import read_segmentation  # its libraries are slow to load

        seg = read_segmentation(path, watch, volume=volume)
        return _Labels(seg.num_voxels, seg.inside, seg.lps_from_ijk, seg.names, seg.notes)
    kind = sniff_format(path) if path.is_file() else None
    if kind not in GRID_FORMATS:
        msg = (
            f"reading the segmentation {path.name}: expected one NIfTI (.nii, .nii.gz), NRRD, MetaImage or DICOM "
            "SEG file; export the segmentation as one of these"
        )
        raise VolumeImportError(msg, code="import.not-an-image")
    values, header, notes = read_grid_array(path, kind, watch=watch)
    low, high = values.min(), values.max()
    if low < -_LARGEST_LABEL or high > _LARGEST_LABEL:
        msg = (
            f"reading the segmentation {path.name}: it contains values from {low:g} to {high:g}, which are not "
            "labels; choose the segmentation file"
        )
        raise VolumeImportError(msg, code="import.mask")
    if values.dtype.kind == "f":
        values = _rounded_labels(path, values, header.scaling)
    numbers, counts = np.unique(values, return_counts=True)
    sizes = {int(number): int(count) for number, count in zip(numbers, counts, strict=True) if number != 0}
    return _Labels(
        sizes, lambda number: (values == number, ()), header.lps_from_ijk, {}, tuple(note.words for note in notes)
    )


def _rounded_labels(path: Path, values: NDArray[Any], scaling: tuple[float, float] | None) -> NDArray[np.int32]:
    """Return the integer labels of a segmentation that stores labels as floating-point numbers.

    nibabel stores floating-point labels under an integer header as multiples of a step (``scl_slope``), so that labels
    0 to 12 are read as 0.988, 2.024, 3.012, ... Such a value differs by at most half a step from its label. A file
    without a step may contain the same numbers as floats; each label then has one single value, near the label.

    Raises
    ------
    VolumeImportError
        ``import.mask``, if the fractions do not come from rounding, as in a probability map.
    """
    if not np.isfinite(values).all():
        raise _fractions(path, "values that are not finite (NaN or infinite)")
    labels: NDArray[np.int32] = np.rint(values).astype(np.int32)
    off = np.abs(values - labels)
    largest = float(off.max())
    if largest == 0.0:
        return labels
    step = None if scaling is None else abs(scaling[0])
    at = int(off.argmax())
    example = float(values.reshape(-1)[at])
    if step is not None and step < 1.0:
        # float32 stores the product of step and number with a relative error of 6e-8.
        allowed = 0.5 * step + 1e-6 * max(1.0, float(np.abs(values).max()))
        if largest > allowed:
            raise _fractions(path, f"{example:.5g}, which is further from a whole number than half a step ({step:.5g})")
        return labels
    if largest > _MAX_FLOAT_LABEL_ERROR + 1e-6 or not _have_one_value(values, labels):
        raise _fractions(path, f"{example:.5g}")
    return labels


def _have_one_value(values: NDArray[Any], labels: NDArray[np.int32]) -> bool:
    """Return whether all voxels of a label have the same value."""
    lowest = int(labels.min())
    if int(labels.max()) - lowest > _MAX_FLOAT_LABELS:
        return False
    index = labels - lowest
    value_of = np.zeros(int(index.max()) + 1, dtype=values.dtype)
    value_of[index.reshape(-1)] = values.reshape(-1)
    return bool((value_of[index] == values).all())


def _fractions(path: Path, found: str) -> VolumeImportError:
    msg = (
        f"reading the segmentation {path.name}: expected whole numbers (0 outside), found {found}; it may be a "
        "probability map; export the segmentation itself"
    )
    return VolumeImportError(msg, code="import.mask")


def _selected_label(path: Path, found: _Labels, label: int | None, voxel_ml: float) -> int:
    """Return the number of the structure that the user selected, or of the only structure."""
    sizes, names = found.num_voxels, found.names
    present = sorted(sizes)
    if not present:
        msg = f"reading the segmentation {path.name}: it is empty (all voxels are 0); export the segmentation again"
        raise VolumeImportError(msg, code="import.mask")
    if len(present) > 1000:
        msg = (
            f"reading the segmentation {path.name}: it contains {len(present)} different values, so it is an image, "
            "not a segmentation; choose the segmentation file"
        )
        raise VolumeImportError(msg, code="import.mask")
    if label is None and len(present) == 1:
        return present[0]
    if label in present:
        assert label is not None
        return label
    listed = ", ".join(f"{n} ({names[n]})" if n in names else str(n) for n in present[:12])
    more = f" and {len(present) - 12} more" if len(present) > 12 else ""
    request = "choose the airway label"
    if label is not None:
        missing = f"{label} ({names[label]}) is empty" if label in names else f"{label} is not among them"
        request = f"{missing}; choose the airway label"
    msg = (
        f"reading the segmentation {path.name}: it contains the labels {listed}{more}; {request} "
        "(--label, or label=N in Python)"
    )
    raise MaskLabelError(msg, tuple(MaskLabel(n, names.get(n) or None, sizes[n] * voxel_ml) for n in present))


def _place_on_grid(
    path: Path,
    inside: NDArray[np.bool_],
    lps_from_mask: NDArray[np.float64],
    volume: Volume,
    *,
    resample: bool,
    watch: Watch,
) -> Mask:
    """Return a structure's mask on the volume's grid: exact if its voxels coincide, otherwise resampled."""
    watch.step("Placing the segmentation", None)
    nz, ny, nx = inside.shape
    volume_from_mask = np.linalg.inv(volume.lps_from_ijk) @ lps_from_mask
    turn = np.rint(volume_from_mask[:3, :3])
    shift = np.rint(volume_from_mask[:3, 3])
    exact = np.eye(4)
    exact[:3, :3], exact[:3, 3] = turn, shift
    corners = np.array([[i, j, k, 1.0] for i in (0, nx - 1) for j in (0, ny - 1) for k in (0, nz - 1)])
    apart = float(np.abs(corners @ (volume_from_mask - exact).T).max())
    is_turn = bool((np.abs(turn).sum(axis=0) == 1).all() and (np.abs(turn).sum(axis=1) == 1).all())
    if not is_turn or apart > _SAME_VOXEL:
        if not resample:
            raise _other_grid_error(path, inside, lps_from_mask, volume)
        mask_from_volume = np.asarray(np.linalg.inv(volume_from_mask), dtype=np.float64)
        return _resample(path, inside, mask_from_volume, volume, watch)
    # Array axes are z, y, x: axis 2 - a of the array is voxel axis a.
    axes = [2 - int(np.argmax(np.abs(turn[2 - row]))) for row in range(3)]
    turned = inside.transpose(axes)
    for row in range(3):
        if turn[2 - row].sum() < 0:
            turned = np.flip(turned, row)
    first = (corners[:, :3] @ turn.T + shift).min(axis=0).astype(int)[::-1]
    out = np.zeros(volume.shape_zyx, dtype=np.uint8)
    low = np.maximum(first, 0)
    high = np.minimum(first + turned.shape, out.shape)
    notes = []
    taken = turned[tuple(slice(max(lo - f, 0), max(hi - f, 0)) for lo, hi, f in zip(low, high, first, strict=True))]
    lost = int(np.count_nonzero(turned)) - int(np.count_nonzero(taken))
    if lost:
        msg = (
            f"reading the segmentation {path.name}: {lost} of its voxels lie outside the scan; it was probably "
            "drawn on a different or larger scan; open the scan it belongs to"
        )
        raise VolumeImportError(msg, code="import.mask-grid")
    out[tuple(slice(lo, hi) for lo, hi in zip(low, high, strict=True))] = taken
    if tuple(turned.shape) != volume.shape_zyx:
        covered = " x ".join(str(n) for n in turned.shape[::-1])
        notes.append(f"the segmentation covers only part of the scan ({covered} voxels)")
    out.flags.writeable = False
    return Mask(out, tuple(notes))


def _resample(
    path: Path, inside: NDArray[np.bool_], mask_from_volume: NDArray[np.float64], volume: Volume, watch: Watch
) -> Mask:
    """Return a structure resampled to the grid of the volume by the nearest voxel."""
    nz, ny, nx = volume.shape_zyx
    out = np.zeros((nz, ny, nx), dtype=np.uint8)
    limits = np.array(inside.shape[::-1])
    i, j = np.meshgrid(np.arange(nx), np.arange(ny), indexing="xy")
    for k in range(nz):
        watch.step("Resampling the segmentation", k / nz)
        plane = np.stack([i, j, np.full_like(i, k)], axis=-1)
        at = np.floor(plane @ mask_from_volume[:3, :3].T + mask_from_volume[:3, 3] + 0.5).astype(np.int64)
        within = ((at >= 0) & (at < limits)).all(axis=-1)
        x, y, z = at[within].T
        out[k][within] = inside[z, y, x]
    if not out.any():
        msg = f"reading the segmentation {path.name}: none of it lies in the scan; open the scan it belongs to"
        raise VolumeImportError(msg, code="import.mask-grid")
    out.flags.writeable = False
    note = "the segmentation was on a different grid; it was resampled to the grid of the scan (nearest voxel)"
    return Mask(out, (note,))


def _other_grid_error(
    path: Path, inside: NDArray[np.bool_], lps_from_mask: NDArray[np.float64], volume: Volume
) -> VolumeImportError:
    """Return the error for a mask on another grid, with a description of both grids."""

    def grid_text(shape_zyx: tuple[int, ...], lps_from_ijk: NDArray[np.float64]) -> str:
        sizes = " x ".join(str(n) for n in shape_zyx[::-1])
        spacing = " x ".join(f"{v:.4g}" for v in np.linalg.norm(lps_from_ijk[:3, :3], axis=0))
        middle = lps_from_ijk[:3, :3] @ ((np.array(shape_zyx[::-1]) - 1) / 2) + lps_from_ijk[:3, 3]
        return f"{sizes} voxels of {spacing} mm around ({', '.join(f'{v:.1f}' for v in middle)})"

    expected, found = grid_text(volume.shape_zyx, volume.lps_from_ijk), grid_text(inside.shape, lps_from_mask)
    share = _share_inside(inside, lps_from_mask, volume)
    grids = f"expected {expected}, found {found}"
    if share == 0.0:
        msg = (
            f"reading the segmentation {path.name}: none of it lies in the scan, and its grid differs from the scan's; "
            f"{grids}; open the scan it belongs to"
        )
        return VolumeImportError(msg, code="import.mask-grid")
    msg = (
        f"reading the segmentation {path.name}: its grid differs from the scan's; {grids}; export it on the "
        "scan's grid, or have it resampled (--resample, or resample=True in Python)"
    )
    return MaskGridError(msg, expected=expected, found=found, share_inside=share)


def _share_inside(inside: NDArray[np.bool_], lps_from_mask: NDArray[np.float64], volume: Volume) -> float:
    """Return the share of a structure that is inside the volume, 0 to 1, from a sample of about ten thousand voxels."""
    step = max(1, int(np.count_nonzero(inside)) // _SAMPLED)
    taken, passed = [], 0
    # Slice by slice, because the indices of all voxels of a large structure would take gigabytes.
    for k, plane in enumerate(inside):
        flat = np.flatnonzero(plane)
        j, i = np.divmod(flat[-passed % step :: step], inside.shape[2])
        taken.append(np.stack([i, j, np.full_like(i, k)], axis=1))
        passed += len(flat)
    voxels = np.concatenate(taken)
    ijk = volume.to_ijk(voxels @ lps_from_mask[:3, :3].T + lps_from_mask[:3, 3])
    return float(((ijk >= -0.5) & (ijk < np.array(volume.shape_zyx[::-1]) - 0.5)).all(axis=1).mean())
