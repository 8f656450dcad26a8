"""Export of airways to a file, in the format of its suffix."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from carina.argument_checks import check_arguments, each, file_path, function, instance
from carina.display.progress import ProgressChoice, progress_function, shows_progress
from carina.errors import check_type
from carina.export.format_table import export_format
from carina.export.mask_file import check_mask_file
from carina.track import Airways, AirwayTree, drawn_tree, lumen_mask, lumen_mesh
from carina.volume import Note, Volume, badges_of


def is_tree_file(path: Path | str) -> bool:
    """Return whether the format of a file name stores only the airway tree, so that no lumen is needed.

    Raises
    ------
    UsageError
        If Carina writes no files with this suffix.
    """
    return export_format(path).kind == "tree"


def check_export(path: Path | str, volume: Volume) -> None:
    """Check, before the airways are searched, that they can be written to a file of this name.

    Parameters
    ----------
    path
        File name with a suffix that Carina writes.
    volume
        The CT.

    Raises
    ------
    UsageError
        If Carina writes no files with this suffix.
    GeometryError
        If the format cannot store the volume's grid; the message names a format that can.

    Examples
    --------
    >>> import carina
    >>> from carina.export import check_export
    >>> check_export("lumen.nii.gz", carina.generate_phantom(spacing_mm=3.0, generations=3).volume)
    """
    if export_format(path).kind == "lumen":
        check_mask_file(path, volume)


def export_tree(path: Path | str, tree: AirwayTree, *, badges: Sequence[Note] = ()) -> Path:
    """Write a tree as ``.json`` (``carina-tree``), ``.vtp``, ``.swc`` or ``.mrk.json``.

    Parameters
    ----------
    path
        File to be written.
    tree
        The tree.
    badges
        Lasting notes of the case (``carina.volume.badges_of``); every format can store them.

    Raises
    ------
    UsageError
        If the suffix is not one of a tree format.
    CarinaError
        If the file cannot be written; a former file stays unchanged.
    """
    return export_format(path, kind="tree").write(Path(path), tree, badges=badges)


@shows_progress
@check_arguments(
    path=file_path(),
    volume=instance(Volume, "open a volume with carina.open_volume"),
    airways=instance(Airways, "get airways from carina.find_airways"),
    tree=instance(AirwayTree, "get one from carina.find_airways", optional=True),
    badges=each(instance(Note, "create a carina.volume.Note")),
    cancel=function,
)
def export_airways(
    path: Path | str,
    volume: Volume,
    airways: Airways,
    *,
    tree: AirwayTree | None = None,
    badges: Sequence[Note] = (),
    progress: ProgressChoice = None,
    cancel: Callable[[], bool] | None = None,
) -> Path:
    """Write the airways to a file, in the format of its suffix.

    ``.json`` (``carina-tree``), ``.vtp``, ``.swc``, ``.mrk.json``: the tree. ``.nii.gz``, ``.nii``, ``.nrrd``,
    ``.mha``: the lumen on the CT's grid. ``.stl``, ``.ply``, ``.obj``, ``.glb``: the lumen's surface. All coordinates
    are in LPS, mm.

    Parameters
    ----------
    path
        File to be written.
    volume, airways
        The CT and the airways in it.
    tree
        Tree to be written instead of that of the airways, such as an edited one.
    badges
        Additional lasting notes; those of the volume and the airways are always written.
    progress
        False, True, None or ``f(what, fraction)``. True and None show a progress bar in a terminal or a notebook; False
        shows none. The fraction is None while the progress is unknown.
    cancel
        Called often; the work stops when it returns True.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    UsageError
        If Carina writes no files with this suffix.
    CarinaError
        If the file cannot be written; a former file stays unchanged.

    Examples
    --------
    >>> import carina
    >>> phantom = carina.generate_phantom(spacing_mm=3.0, generations=3)
    >>> airways = carina.find_airways(phantom.volume)
    >>> carina.export_airways("lumen.stl", phantom.volume, airways).name
    'lumen.stl'
    """
    check_type("export_airways", "volume", volume, Volume, "open a volume with carina.open_volume")
    check_type("export_airways", "airways", airways, Airways, "get airways from carina.find_airways")
    check_export(path, volume)
    lasting = tuple(dict.fromkeys([*badges_of(volume, airways), *badges]))
    to = export_format(path)
    if to.kind == "tree":
        return export_tree(path, airways.tree if tree is None else tree, badges=lasting)
    # The note describes the lumen, so it uses the tree of the airways and not ``tree``.
    words = drawn_tree(airways.tree).words
    note = None if words is None else f"{words}: not from the CT"
    if to.kind == "surface":
        mesh = lumen_mesh(volume, airways, progress=progress_function(progress), cancel=cancel)
        return to.write(path, mesh, note=note, badges=lasting)
    return to.write(path, lumen_mask(volume, airways), volume, note=note, badges=lasting)
