"""Outlines of the structures around a target in planar images: masks cut by the plane of the image."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.plan.lungs.lung_map import LungMap, MappedMask
from carina.track import MaskOutline

if TYPE_CHECKING:
    from carina.plan import Nodule, ReachAtlas

LayerName = Literal["vessels", "fissures", "lobes", "reach"]
LAYERS: tuple[LayerName, ...] = get_args(LayerName)

UNIT_MM = 0.25
"""Unit, in mm, of the integer coordinates of encoded outlines.

Outlines are cut in the plane and not in the pixels of an image, so that zooming requires no new cut, and a line that
leaves the image is still closed.
"""
MAX_STORED = 24
"""Number of planes of a mask whose outlines are cached: images are zoomed or resent more often than planes move."""


@one_line
@dataclass(frozen=True, slots=True)
class OutlineLines:
    """Outline of a mask in one image, as encoded closed lines."""

    data: bytes
    """Encoded outline (:meth:`carina.track.LumenOutline.encoded`)."""
    complete: bool
    """Whether there is an outline; False if the mask is too irregular for one, and the message then contains none."""


@one_line
@dataclass(frozen=True, slots=True)
class LayerLines(OutlineLines):
    """The outline of one part of a layer in one image; its coordinates are sixteenths of :data:`UNIT_MM`."""

    layer: LayerName
    part: str
    """*sure* or *unsure* for vessels and reach, *seen* for fissures, the name of the lobe for lobes."""
    pixel_from_line: tuple[float, float, float, float, float, float]
    """Affine map from outline units to image columns and rows, in the order of a canvas's ``transform``."""


class _LayerMask:
    """One mask of a layer, with its surface, which is computed at the first cut by an image plane and cached."""

    def __init__(self, layer: LayerName, part: str, mask: MappedMask, without: tuple[Nodule, ...] = ()) -> None:
        self.layer, self.part = layer, part
        self._mask, self._without = mask, without
        self._lock = threading.Lock()
        self._outline: MaskOutline | None = None
        self._cache: OrderedDict[bytes, bytes | None] = OrderedDict()
        num = np.array(mask.inside_zyx.shape[::-1])
        ends = np.array([[i, j, k, 1] for i in (-1, num[0]) for j in (-1, num[1]) for k in (-1, num[2])], dtype=float)
        self._corners = (ends @ mask.lps_from_ijk.T)[:, :3]

    def lines(self, lps_from_pixel: NDArray[np.float64]) -> LayerLines | None:
        """Return the outline of the mask in an image; None if the plane of the image does not intersect the mask."""
        right, down, normal = (_unit_vector(lps_from_pixel[:3, n]) for n in range(3))
        depth = float(normal @ lps_from_pixel[:3, 3])
        depths = self._corners @ normal
        if not depths.min() < depth < depths.max():
            return None
        places = np.stack([self._corners @ right, self._corners @ down])
        low, high = places.min(axis=1), places.max(axis=1)
        lps_from_line = np.eye(4)
        lps_from_line[:3, :3] = np.stack([UNIT_MM * right, UNIT_MM * down, normal], axis=1)
        # Right, down and normal are orthonormal, because the pixels of a planar image are rectangular.
        lps_from_line[:3, 3] = low[0] * right + low[1] * down + depth * normal
        width, height = (int(n) for n in np.ceil((high - low) / UNIT_MM))
        data = self._cut_mask(lps_from_line, width, height)
        to = np.linalg.inv(lps_from_pixel) @ lps_from_line
        place = (to[0, 0], to[1, 0], to[0, 1], to[1, 1], to[0, 3], to[1, 3])
        a, b, c, d, e, f = (float(v) for v in place)
        return LayerLines(data or b"", data is not None, self.layer, self.part, (a, b, c, d, e, f))

    def _cut_mask(self, lps_from_line: NDArray[np.float64], width: int, height: int) -> bytes | None:
        # Rounded to 0.01 mm, far below the voxel size of any mask.
        key = np.round(lps_from_line * 100.0).tobytes()
        with self._lock:
            if key in self._cache:
                self._cache.move_to_end(key)
                return self._cache[key]
            if self._outline is None:
                self._outline = MaskOutline(self._mask_without_nodules(), self._mask.lps_from_ijk)
        data = self._outline.encoded(lps_from_line, width, height)
        with self._lock:
            self._cache[key] = data
            while len(self._cache) > MAX_STORED:
                self._cache.popitem(last=False)
        return data

    def _mask_without_nodules(self) -> NDArray[np.bool_]:
        """Return the mask without the voxels of nodules, because a target must not be drawn as a vessel."""
        inside, matrix = self._mask.inside_zyx, self._mask.lps_from_ijk
        for nodule in self._without:
            reach = 0.5 * np.array(nodule.inside_zyx.shape[::-1]) @ np.abs(nodule.lps_from_ijk[:3, :3]).T + matrix[0, 0]
            middle = 0.5 * (np.array(nodule.inside_zyx.shape[::-1]) - 1) @ nodule.lps_from_ijk[:3, :3].T
            at = (middle + nodule.lps_from_ijk[:3, 3] - matrix[:3, 3]) / matrix[0, 0]
            low = np.maximum(np.floor(at - reach / matrix[0, 0]).astype(int), 0)
            high = np.minimum(np.ceil(at + reach / matrix[0, 0]).astype(int) + 1, inside.shape[::-1])
            if (low >= high).any():
                continue
            part = tuple(slice(a, b) for a, b in zip(low[::-1], high[::-1], strict=True))
            places = np.argwhere(np.ones(inside[part].shape, dtype=bool))[:, ::-1] + low
            held = nodule.contains(places * matrix[0, 0] + matrix[:3, 3]).reshape(inside[part].shape)
            inside = inside.copy() if inside is self._mask.inside_zyx else inside
            inside[part] &= ~held
        return inside


def _unit_vector(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    found: NDArray[np.float64] = vector / np.linalg.norm(vector)
    return found


class ShownLayers:
    """The available layers of a case; immutable, identified by object identity, and usable by any thread.

    Parameters
    ----------
    lungs
        Vessels, fissures and lobes, as far as they are known.
    reach
        Region that an instrument reaches.
    nodules
        The targets; no target is drawn as a vessel.
    """

    def __init__(self, lungs: LungMap | None, reach: ReachAtlas | None, nodules: tuple[Nodule, ...] = ()) -> None:
        self._parts = (*_lung_parts(lungs, nodules), *_reach_parts(reach))

    def __repr__(self) -> str:
        """Describe the layers by their names."""
        return f"ShownLayers({', '.join(dict.fromkeys(part.layer for part in self._parts)) or 'none'})"

    @property
    def names(self) -> tuple[LayerName, ...]:
        """Names of the available layers."""
        return tuple(dict.fromkeys(part.layer for part in self._parts))

    def lines(self, lps_from_pixel: NDArray[np.float64], wanted: Collection[LayerName]) -> tuple[LayerLines, ...]:
        """Return the outlines of the wanted layers in a planar image with this pixel-to-LPS matrix (mm)."""
        found = (part.lines(lps_from_pixel) for part in self._parts if part.layer in wanted)
        return tuple(one for one in found if one is not None)


def _lung_parts(lungs: LungMap | None, nodules: tuple[Nodule, ...]) -> Iterator[_LayerMask]:
    if lungs is None:
        return
    for name, mask in lungs.lobes:
        yield _LayerMask("lobes", name, mask)
    if lungs.fissures is not None:
        yield _LayerMask("fissures", "seen", lungs.fissures)
    # The outline of all vessels is drawn dashed, and the outline of the clearly visible vessels solid over it.
    if lungs.vessels is not None:
        yield _LayerMask("vessels", "unsure", lungs.vessels, nodules)
    if lungs.sure_vessels is not None:
        yield _LayerMask("vessels", "sure", lungs.sure_vessels, nodules)


def _reach_parts(reach: ReachAtlas | None) -> Iterator[_LayerMask]:
    if reach is None:
        return
    yield _LayerMask("reach", "unsure", MappedMask.placed(reach.reach_zyx > 0, reach.lps_from_ijk))
    yield _LayerMask("reach", "sure", MappedMask.placed(reach.reach_zyx > 1, reach.lps_from_ijk))
