"""Airways to any file, by its suffix."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from carina.errors import UsageError, check_type
from carina.export.mask_file import MASK_SUFFIXES, write_mask
from carina.export.mesh_file import MESH_SUFFIXES, write_mesh
from carina.export.tree_file import write_tree
from carina.export.tree_formats import write_markups, write_swc, write_vtp
from carina.track import Airways, AirwayTree, drawn_tree, lumen_mesh
from carina.volume import Note, Volume, badges_of

__all__ = ["EXPORT_SUFFIXES", "export_airways", "export_tree", "is_tree_file"]

# ".mrk.json" before ".json".
_TREE_WRITERS: dict[str, Callable[..., Path]] = {
    ".mrk.json": write_markups,
    ".json": write_tree,
    ".vtp": write_vtp,
    ".swc": write_swc,
}
EXPORT_SUFFIXES = (*_TREE_WRITERS, *MASK_SUFFIXES, *MESH_SUFFIXES)
"""Suffixes that :func:`export_airways` knows."""


def is_tree_file(path: Path | str) -> bool:
    """Whether a file of this name holds the tree alone, for which no lumen is needed.

    Raises
    ------
    UsageError
        If the suffix is none that Carina writes.
    """
    name = Path(path).name.lower()
    if not name.endswith(EXPORT_SUFFIXES):
        msg = f"expected a file name that ends in {', '.join(EXPORT_SUFFIXES)}; found {Path(path).name!r}"
        raise UsageError(msg)
    return name.endswith(tuple(_TREE_WRITERS))


def export_tree(path: Path | str, tree: AirwayTree, *, badges: Sequence[Note] = ()) -> Path:
    """Write a tree as ``.json`` (``carina-tree``), ``.vtp``, ``.swc`` or ``.mrk.json``.

    ``badges``: the lasting notes of its case (``carina.volume.badges_of``); every format has a place for them.

    Raises
    ------
    UsageError
        If the suffix is another.
    CarinaError
        If it cannot be written; what was there before stays.
    """
    name = Path(path).name.lower()
    for suffix, writer in _TREE_WRITERS.items():
        if name.endswith(suffix):
            return writer(Path(path), tree, badges=badges)
    msg = f"a tree is written as {', '.join(_TREE_WRITERS)}; found {Path(path).name!r}"
    raise UsageError(msg)


def export_airways(
    path: Path | str,
    volume: Volume,
    airways: Airways,
    *,
    tree: AirwayTree | None = None,
    badges: Sequence[Note] = (),
    progress: Callable[[str, float | None], None] | None = None,
    cancel: Callable[[], bool] | None = None,
) -> Path:
    """Write the airways to a file; its suffix says what.

    ``.json`` (``carina-tree``), ``.vtp``, ``.swc``, ``.mrk.json``: the tree. ``.nii.gz``, ``.nii``, ``.nrrd``,
    ``.mha``: the lumen on the CT's grid. ``.stl``, ``.ply``, ``.obj``, ``.glb``: the lumen's surface. All in LPS, mm.

    Parameters
    ----------
    path
        Where to.
    volume, airways
        The CT and what was found in it.
    tree
        Another tree than that of the airways (one that a person mended).
    badges
        Lasting notes beside those of the volume and the airways, which are written in any case.

    Raises
    ------
    UsageError
        If the suffix is another.
    CarinaError
        If it cannot be written; what was there before stays.

    Examples
    --------
    >>> import carina
    >>> phantom = carina.generate_phantom(spacing_mm=3.0, generations=3)
    >>> airways = carina.find_airways(phantom.volume)
    >>> carina.export_airways("lumen.stl", phantom.volume, airways).name
    'lumen.stl'
    """
    check_type("export_airways", "volume", volume, Volume, "open one with carina.open_volume")
    check_type("export_airways", "airways", airways, Airways, "find them with carina.find_airways")
    lasting = tuple(dict.fromkeys([*badges_of(volume, airways), *badges]))
    if is_tree_file(path):
        return export_tree(path, airways.tree if tree is None else tree, badges=lasting)
    # The lumen's own tree, whatever tree was given beside it.
    words = drawn_tree(airways.tree).words
    note = None if words is None else f"{words}: not from the CT"
    if Path(path).name.lower().endswith(MESH_SUFFIXES):
        mesh = lumen_mesh(volume, airways, progress=progress, cancel=cancel)
        return write_mesh(path, mesh, note=note, badges=lasting)
    return write_mask(path, airways.lumen_zyx, volume, note=note, badges=lasting)
