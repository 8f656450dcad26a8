"""Scene of a renderer: voxel values with the endoscopic wall, and radius maps for empty-space skipping.

A change creates a new scene, so each picture is rendered from one consistent state.
"""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from carina import _core
from carina.errors import CancelledError, GeometryError
from carina.render.isoregion_cache import CachedMap, MapCache, MapName
from carina.render.isoregion_file import open_isoregion_map
from carina.render.transfer_function import TransferFunction, transfer_from_histogram, transfer_preset
from carina.render.tree import LeapedValues, TreeField, build_tree_field
from carina.render.value_labels import bin_width, value_labels
from carina.render.wall import wall_levels, with_wall
from carina.render.wall_texture import Decoration, DecorationTree, decoration_of
from carina.volume import Volume

Progress = Callable[[str, float | None], None]
Cancel = Callable[[], bool]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Maps(LeapedValues):
    """Voxel values and radius map for leaps over the classes that one transfer function shows as transparent."""

    runs: tuple[tuple[int, int], ...]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ClassMaps(LeapedValues):
    """Labels of all classes, radii of all labels, and one value of each class; method ``leap-all`` reads them."""

    points: NDArray[np.float64]
    labels: NDArray[np.uint8]
    class_values: list[int]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ValueMaps:
    """Labels and radii of equal values in one array, and one value of each label, for transfer functions of the paper.

    Labels are in the order of their values.
    """

    words: NDArray[np.uint16]
    """Label of each voxel plus 256 times the radius of its cube of equal labels, (nz, ny, nx)."""
    label_values: list[int]


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Immutable input of pictures: transfer function, lumen, values and maps."""

    transfer: TransferFunction
    lumen: NDArray[np.uint8] | None
    values: NDArray[np.int16]
    """Voxel values that the airway view shows: the volume's values, or a copy in which the lumen's wall is closed."""
    range: tuple[int, int]
    tree: TreeField | None
    maps: Maps | None
    class_maps: ClassMaps | ValueMaps | None
    decoration: Decoration | None = None
    bin_width: int = 1
    """Width of the bins of values that have one colour; 1 if each value has its own."""


def value_maps(labels: NDArray[np.uint8], radius: NDArray[np.uint8], label_values: list[int]) -> ValueMaps:
    """Return labels from 1 on, their values and their radii with the labels in the order of the values.

    A ray does not read the segment table at labels before the first visible one, which are the most in this order.
    """
    order = np.argsort(label_values)
    label_of = np.zeros(256, dtype=np.uint16)
    label_of[order + 1] = np.arange(1, len(order) + 1)
    words = np.empty(labels.shape, dtype=np.uint16)
    # Slices are converted one by one, so that no second array of the volume's size is needed.
    for word, label, reach in zip(words, labels, radius, strict=True):
        word[:] = label_of[label] | (reach.astype(np.uint16) << 8)
    return ValueMaps(words=words, label_values=[label_values[n] for n in order])


class SceneBuilder:
    """Owner of the current scene of one volume, which builds its successors; see :class:`carina.render.Renderer`."""

    def __init__(self, volume: Volume, transfer: TransferFunction | None, cache_dir: Path | None) -> None:
        if transfer is None:
            transfer = transfer_preset("endoscopic") if volume.is_hu else transfer_from_histogram(volume)[0]
        self._volume = volume
        self._cache = None if cache_dir is None else MapCache(cache_dir)
        self._range = volume.value_range
        width = _bin_width(transfer, volume.hu_zyx)
        self._scene = Scene(transfer, None, volume.hu_zyx, self._range, None, None, None, bin_width=width)
        self._known_radius: tuple[int, NDArray[np.uint8]] | None = None
        """Width of the bins, and IsoRegion map of the volume by these bins, read from a file."""
        self._swap = threading.Lock()
        self._change = threading.Lock()

    @property
    def scene(self) -> Scene:
        """Current state of everything that the renderer shows: maps, transfer function, lumen and decoration."""
        return self._scene

    def adopt(self, scene: Scene) -> None:
        """Replace the scene by one that another `SceneBuilder` of the same volume has built."""
        if scene.values.shape != self._volume.shape_zyx:
            msg = (
                f"the scene's values have shape {scene.values.shape}; expected that of the volume, "
                f"{self._volume.shape_zyx}"
            )
            raise GeometryError(msg, code="geometry.shape")
        with self._change, self._swap:
            self._scene = scene

    def use_isoregion_map(self, path: Path | None) -> None:
        """Use the map of the volume by values from a file, instead of building it; None builds it again.

        The map must compare values as the current transfer function does, and serves only for such functions.
        """
        width = self._scene.bin_width
        radius = None
        if path is not None:
            radius = open_isoregion_map(path, self._volume, equal_by="values" if width == 1 else "bins")
        self._known_radius = None if radius is None else (width, radius)

    def set_transfer(self, transfer: TransferFunction) -> None:
        """Set the transfer function; the radius map is retained if it fits the new transfer function."""
        with self._change:
            self._replace(transfer, self._scene.lumen, self._scene.tree, self._scene.decoration)

    def set_lumen(self, lumen_zyx: NDArray[np.uint8] | None, tree: DecorationTree | None = None) -> None:
        """Set the lumen (nz, ny, nx), or None, and its tree; build the wall and the field of the tree view."""
        if lumen_zyx is not None:
            lumen_zyx = np.ascontiguousarray(lumen_zyx, dtype=np.uint8)
            if lumen_zyx.shape != self._volume.shape_zyx:
                msg = f"the lumen has shape {lumen_zyx.shape}; expected that of the volume, {self._volume.shape_zyx}"
                raise GeometryError(msg, code="geometry.shape")
        decoration = None if lumen_zyx is None else decoration_of(tree)
        present = self._scene
        if lumen_zyx is None:
            outside = None
        elif lumen_zyx is present.lumen:
            outside = present.tree
        else:
            outside = build_tree_field(lumen_zyx, self._volume.lps_from_ijk)
        with self._change:
            self._replace(self._scene.transfer, lumen_zyx, outside, decoration)

    def _replace(
        self,
        transfer: TransferFunction,
        lumen: NDArray[np.uint8] | None,
        tree: TreeField | None,
        decoration: Decoration | None,
    ) -> None:
        old = self._scene
        walled = transfer.wall and lumen is not None
        levels = wall_levels(transfer)
        was_walled = old.transfer.wall and old.lumen is not None
        if not walled:
            values, value_range = self._volume.hu_zyx, self._range
        elif was_walled and old.lumen is lumen and wall_levels(old.transfer) == levels:
            values, value_range = old.values, old.range
        else:
            assert lumen is not None
            values = with_wall(self._volume.hu_zyx, lumen, levels)
            value_range = (self._range[0], max(self._range[1], _core.value_range(values)[1]))
        # A map that no longer fits is dropped: building it again is fast, and a map takes half the memory of the
        # volume.
        width = _bin_width(transfer, values)
        runs = _transparent_runs(transfer, width)
        can_reuse = old.maps is not None and old.maps.values is values and old.maps.runs == runs
        with self._swap:
            maps = old.maps if can_reuse else None
            self._scene = Scene(transfer, lumen, values, value_range, tree, maps, None, decoration, width)

    def prepare(
        self, progress: Progress | None = None, cancel: Cancel | None = None, *, all_classes: bool | None = None
    ) -> None:
        """Build the radius maps that the current scene lacks, or read them from the cache."""

        def step(what: str, fraction: float | None) -> None:
            if cancel is not None and cancel():
                raise CancelledError("stopped while preparing fast rendering")
            if progress is not None:
                progress(what, fraction)

        what = "preparing fast rendering"
        while True:
            scene = self._scene
            # The paper's transfer functions are never shaded, so all classes are leaped.
            by_paper = scene.transfer.sampling == "nearest"
            wants_classes = by_paper if all_classes is None else all_classes
            step(what, 0.0)
            maps = scene.maps
            if maps is None and not (by_paper and wants_classes):
                maps = self._build_maps(scene, cancel)
            step(what, 0.3 if wants_classes else 1.0)
            class_maps = scene.class_maps
            if wants_classes and class_maps is None:
                class_maps = self._build_class_maps(scene, cancel)
            step(what, 1.0)
            with self._swap:
                # If the transfer function or the lumen changed meanwhile, the maps are stale and are built again.
                if self._scene is scene:
                    self._scene = dataclasses.replace(scene, maps=maps, class_maps=class_maps)
                    return

    def _get_or_build(self, name: MapName, build: Callable[[], CachedMap]) -> CachedMap:
        return build() if self._cache is None else self._cache.get_or_build(name, build)

    def _build_maps(self, scene: Scene, cancel: Cancel | None) -> Maps:
        runs = _transparent_runs(scene.transfer, scene.bin_width)
        found = self._get_or_build(
            MapName(scene.values, ("clear-cells", runs)),
            lambda: CachedMap((_core.build_cell_map(scene.values, runs, cancel=cancel),)),
        )
        return Maps(values=scene.values, radius=found.arrays[0], runs=runs)

    def _build_class_maps(self, scene: Scene, cancel: Cancel | None) -> ClassMaps | ValueMaps:
        transfer = scene.transfer
        if transfer.sampling == "nearest":
            return self._build_value_maps(scene, cancel)

        def build() -> CachedMap:
            labels, classes = _core.label_classes(scene.values, transfer.points, reference_mm=transfer.reference_mm)
            return CachedMap((labels, _core.build_radius_map(labels, cancel=cancel)), [lo for lo, _, _, _ in classes])

        classes = ("classes", transfer.points.tolist(), transfer.reference_mm)
        found = self._get_or_build(MapName(scene.values, classes), build)
        labels, radius = found.arrays
        return ClassMaps(
            values=scene.values, radius=radius, points=transfer.points, labels=labels, class_values=found.meaning
        )

    def _build_value_maps(self, scene: Scene, cancel: Cancel | None) -> ValueMaps:
        known = self._known_radius if scene.values is self._volume.hu_zyx else None
        if known is not None and known[0] != scene.bin_width:
            known = None

        def build() -> CachedMap:
            labels, lowest = value_labels(scene.values, "values" if scene.bin_width == 1 else "bins")
            if known is None:
                radius = _core.build_radius_map(labels, cancel=cancel)
            else:
                # Voxels without a label have no class to leap over.
                radius = np.where(labels == 0, np.uint8(0), known[1])
            return CachedMap((labels, radius), [int(value) for value in lowest])

        # The cache stores only maps that were built here.
        name = MapName(scene.values, ("values", scene.bin_width))
        found = build() if known is not None else self._get_or_build(name, build)
        labels, radius = found.arrays
        return value_maps(labels, radius, found.meaning)

    def wait_stored(self) -> None:
        """Wait until the cache has written the radius maps."""
        if self._cache is not None:
            self._cache.wait_stored()


def _bin_width(transfer: TransferFunction, values: NDArray[np.int16]) -> int:
    """Return the width of the bins of one colour: the paper's transfer functions show up to 256 values as they are."""
    return 1 if transfer.bin_hu == 1 else bin_width(values)


def _transparent_runs(transfer: TransferFunction, width: int) -> tuple[tuple[int, int], ...]:
    runs = _core.transparent_runs(transfer.points, reference_mm=transfer.reference_mm, bin_hu=width)
    return tuple(runs)
