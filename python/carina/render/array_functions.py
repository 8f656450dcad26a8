"""Data structures of the renderer as plain arrays, for scripts: IsoRegion maps, projections, planes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carina import _core
from carina.argument_checks import check_arguments, choice, instance
from carina.errors import GeometryError, UsageError, check_type
from carina.render.transfer_function import TransferFunction
from carina.render.value_labels import EQUAL_BY, EqualBy, value_labels
from carina.volume import Volume


def build_isoregion_map(labels_zyx: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return for every voxel the radius of the largest cube of equal labels centred on it.

    Parameters
    ----------
    labels_zyx
        (nz, ny, nx) uint8, C order. Label 0 is never leaped: its radius is 0. Not modified.

    Returns
    -------
    numpy.ndarray
        (nz, ny, nx) uint8 of chessboard radii: the cube of a voxel has ``2 r + 1`` voxels on each side. 0 marks a voxel
        with an unequal or missing neighbour; cubes beyond 255 are recorded as 255.

    Raises
    ------
    GeometryError
        If the array has not three axes, or one of them is empty.

    References
    ----------
    Paper 4.2.

    Examples
    --------
    >>> build_isoregion_map(np.ones((5, 5, 5), np.uint8))[2, 2]
    array([0, 1, 2, 1, 0], dtype=uint8)
    """
    if labels_zyx.ndim != 3 or 0 in labels_zyx.shape:
        raise GeometryError(
            f"expected labels with three non-empty axes; found shape {labels_zyx.shape}", code="geometry.shape"
        )
    return _core.build_radius_map(np.ascontiguousarray(labels_zyx, dtype=np.uint8))


@check_arguments(
    volume=instance(Volume, "open a volume with carina.open_volume"),
    transfer=instance(TransferFunction, "get one from carina.transfer_preset", optional=True),
    equal_by=choice(*EQUAL_BY),
)
def isoregion_map(
    volume: Volume, transfer: TransferFunction | None = None, *, equal_by: EqualBy = "auto"
) -> NDArray[np.uint8]:
    """Return the IsoRegion map of a volume: for every voxel the largest cube of equal voxels centred on it.

    Parameters
    ----------
    volume
        The scan.
    transfer
        Voxels count as equal if this transfer function shows them in the same colour and opacity, as for leaps of
        pictures. With None, voxels count as equal if their values or bins do.
    equal_by
        Comparison without a transfer function. ``auto``: by value, as in the paper, if the volume has at most 256
        different values, else by bins of 16. ``values`` or ``bins``: always by values, or by bins of 16.

    Returns
    -------
    numpy.ndarray
        (nz, ny, nx) uint8, chessboard radii: see :func:`build_isoregion_map`. In a noisy CT few voxels have equal
        neighbours within 16 HU.

    Raises
    ------
    UsageError
        If values are requested and the volume has more than 256 different ones, or if a transfer function and a
        comparison are given.

    References
    ----------
    Paper 4.1, 4.2: "the results can be bundled with the volume".

    Examples
    --------
    >>> import carina
    >>> phantom = carina.generate_phantom(spacing_mm=3.0, generations=3)
    >>> radii = isoregion_map(phantom.volume, carina.transfer_preset("endoscopic"))
    >>> radii.shape == phantom.volume.shape_zyx
    True
    """
    check_type("isoregion_map", "volume", volume, Volume, "open a volume with carina.open_volume")
    labels = isoregion_labels(volume, transfer, equal_by=equal_by)
    radii = _core.build_radius_map(labels)
    if transfer is None and len(found := np.unique(volume.hu_zyx[labels == 0])) == 1:
        # With 256 values the rarest one has no label, because labels have 8 bits.
        radii = np.maximum(radii, _core.build_radius_map((volume.hu_zyx == found[0]).astype(np.uint8)))
    return radii


def isoregion_labels(
    volume: Volume, transfer: TransferFunction | None, *, equal_by: EqualBy = "auto"
) -> NDArray[np.uint8]:
    """Return the labels (nz, ny, nx) uint8 that :func:`isoregion_map` compares; see there for the arguments."""
    if transfer is None:
        return value_labels(volume.hu_zyx, equal_by)[0]
    if equal_by != "auto":
        raise UsageError("equal_by: expected auto beside a transfer function, whose classes are compared")
    return _core.label_classes(volume.hu_zyx, transfer.points, reference_mm=transfer.reference_mm)[0]


def project_maximum(volume: Volume) -> tuple[NDArray[np.int16], NDArray[np.int16], NDArray[np.int16]]:
    """Compute the maximum intensity projections along the grid's axes, in one pass (paper 3.1).

    Returns
    -------
    tuple
        Along i ``[k, j]``, along j ``[k, i]`` and along k ``[j, i]``; HU, int16.
    """
    return _core.project_maximum(volume.hu_zyx)


def sample_plane(
    volume: Volume, lps_from_pixel: NDArray[np.float64], *, width: int, height: int, window_hu: tuple[float, float]
) -> NDArray[np.uint8]:
    """Return grey levels of any plane of the volume, trilinearly interpolated.

    Parameters
    ----------
    volume
        The volume.
    lps_from_pixel
        4x4; maps (column, row, depth in mm, 1) to LPS mm; pixel (0, 0) is the *corner* of the first pixel.
    width, height
        Size in pixels.
    window_hu
        Width and level.

    Returns
    -------
    numpy.ndarray
        (height, width) uint8; 0 outside the volume.
    """
    grey, _ = _core.cut_plane(
        volume.hu_zyx, volume.lps_from_ijk, lps_from_pixel, width=width, height=height, window_hu=window_hu
    )
    return grey
