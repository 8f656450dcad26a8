"""Files of IsoRegion maps: the note that identifies a map, and a reader that refuses the map of another scan.

Paper 4.2: the map is computed once and stored beside the volume, or with it in one file.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from carina.argument_checks import check_arguments, choice, file_path, instance
from carina.errors import VolumeImportError
from carina.render.array_functions import isoregion_labels
from carina.render.transfer_function import TransferFunction
from carina.render.value_labels import EQUAL_BY, EqualBy, equal_by_name
from carina.volume import Volume
from carina.volume.grid_files import read_grid_array
from carina.volume.grid_headers import read_grid_header, sniff_format
from carina.volume.header_fields import GridHeader
from carina.volume.io_errors import guarded
from carina.volume.isoregion_bundle import MAP_FORMAT, MAP_NOTE, MAP_TAG, contains_map, read_bundled_map, short_digest
from carina.volume.progress import Watch

_SAME_VOXEL = 0.05
"""Tolerance of a position in voxels; float32 headers are exact to about 1e-4 mm."""
_WITH_SCAN = " --with-scan"
"""Command-line option that writes the scan with its radius map again, because a map alone would replace the scan."""


def isoregion_note(volume: Volume, labels_zyx: NDArray[np.uint8], radii_zyx: NDArray[np.uint8]) -> str:
    """Return the note that identifies the volume, the labels and the radii of a map in its file.

    Parameters
    ----------
    volume
        The scan.
    labels_zyx
        Labels of the voxels; see :func:`carina.render.isoregion_labels`.
    radii_zyx
        The map.

    Returns
    -------
    str
        At most 60 characters, because NIfTI stores 79.
    """
    return " ".join([MAP_TAG, MAP_FORMAT, *(short_digest(values) for values in (volume.hu_zyx, labels_zyx, radii_zyx))])


@check_arguments(
    path=file_path(),
    volume=instance(Volume, "open a volume with carina.open_volume"),
    transfer=instance(TransferFunction, "get one from carina.transfer_preset", optional=True),
    equal_by=choice(*EQUAL_BY),
)
def open_isoregion_map(
    path: str | Path, volume: Volume, transfer: TransferFunction | None = None, *, equal_by: EqualBy = "auto"
) -> NDArray[np.uint8]:
    """Read an IsoRegion map that ``carina isoregion`` wrote, and check that it belongs to a volume.

    Parameters
    ----------
    path
        The file of the map (NIfTI, NRRD or MetaImage), or of the scan with its map (``carina isoregion --with-scan``).
    volume
        The scan from which the map was computed.
    transfer
        Transfer function by which voxels were equal; None as in :func:`isoregion_map`.
    equal_by
        Comparison of the values without a transfer function, as in :func:`isoregion_map`.

    Returns
    -------
    numpy.ndarray
        (nz, ny, nx) uint8, equal to ``isoregion_map(volume, transfer, equal_by=equal_by)``.

    Raises
    ------
    VolumeImportError
        ``import.isoregion-map``: if the file is damaged, or is the map of another grid, another volume or another
        labelling. The message states the reason and how to compute the map again.

    References
    ----------
    Paper 4.2: "the results can be bundled with the volume".
    """
    options = "" if equal_by == "auto" else f" --equal-by {equal_by}"
    if transfer is not None:
        options = f" --transfer {transfer.name}"
    radii, header = guarded(Path(path).expanduser(), lambda where: _read(where, volume, options))
    where = Path(path)
    if contains_map(header):
        options = _WITH_SCAN + options
    found = MAP_NOTE.search(header.head)
    if found is None:
        raise _refused(
            where, "it is not an IsoRegion map of Carina, or of a version that did not identify its maps", options
        )
    version, *digests = (part.decode() if part else "" for part in found.groups())
    if version != MAP_FORMAT:
        raise _refused(
            where, f"it is an IsoRegion map of format {version}, which this version of Carina cannot read", options
        )
    of_volume, of_labels, of_radii = digests
    if of_volume != short_digest(volume.hu_zyx):
        raise _refused(where, "it is the IsoRegion map of another volume with the same grid", options)
    if of_labels != short_digest(isoregion_labels(volume, transfer, equal_by=equal_by)):
        equal = equal_by_name(volume.hu_zyx, equal_by) if transfer is None else f"the transfer function {transfer.name}"
        problem = f"voxels were compared in another way; expected a map of voxels that are equal by {equal}"
        raise _refused(where, problem, options)
    if of_radii != short_digest(radii):
        raise _refused(where, "its radii were changed after it was written, so the file is damaged", options)
    return radii


def _read(path: Path, volume: Volume, options: str) -> tuple[NDArray[np.uint8], GridHeader]:
    """Return the radii and the header of a map file whose grid is that of the volume."""
    if not path.exists():
        raise _refused(path, "there is no such file", options)
    form = sniff_format(path) if path.is_file() else None
    if form not in ("nifti", "nrrd", "metaimage"):
        raise _refused(path, "it is not a NIfTI, NRRD or MetaImage file", options)
    watch = Watch(None, None)
    header = read_grid_header(path, form)
    if contains_map(header):
        options = _WITH_SCAN + options
        values: NDArray[np.generic] = read_bundled_map(path, header, watch)
    else:
        values, header, _ = read_grid_array(path, form, watch=watch)
    expected = _grid_text(volume.shape_zyx, volume.lps_from_ijk)
    if values.shape != volume.shape_zyx or _voxels_apart(volume, header.lps_from_ijk) > _SAME_VOXEL:
        found = _grid_text(values.shape, header.lps_from_ijk)
        raise _refused(path, f"its grid differs from that of the scan: expected {expected}; found {found}", options)
    if values.dtype != np.uint8:
        raise _refused(path, f"its values are {values.dtype.name}; the radii of a map are uint8", options)
    return np.ascontiguousarray(values, dtype=np.uint8), header


def _grid_text(shape_zyx: tuple[int, ...], lps_from_ijk: NDArray[np.float64]) -> str:
    sizes = " x ".join(str(n) for n in shape_zyx[::-1])
    spacing = " x ".join(f"{v:.4g}" for v in np.linalg.norm(lps_from_ijk[:3, :3], axis=0))
    first = ", ".join(f"{v:.1f}" for v in lps_from_ijk[:3, 3])
    return f"{sizes} voxels of {spacing} mm from ({first})"


def _voxels_apart(volume: Volume, lps_from_ijk: NDArray[np.float64]) -> float:
    """Return the largest distance, in voxels, between the corners of the volume's grid and those of another grid."""
    ni, nj, nk = (n - 1 for n in volume.shape_zyx[::-1])
    corners = np.array([[i, j, k, 1.0] for i in (0, ni) for j in (0, nj) for k in (0, nk)])
    apart_mm = np.linalg.norm((corners @ (volume.lps_from_ijk - lps_from_ijk).T)[:, :3], axis=1).max()
    return float(apart_mm / np.linalg.norm(volume.lps_from_ijk[:3, :3], axis=0).min())


def _refused(path: Path, problem: str, options: str) -> VolumeImportError:
    return VolumeImportError(
        f"reading {path.name}: {problem}; compute the map again with: carina isoregion SCAN -o {path.name}{options}",
        code="import.isoregion-map",
    )
