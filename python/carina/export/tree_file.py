"""Reading and writing of the airway tree as a file, ``tree.json`` (docs/contracts.md)."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path

from carina.argument_checks import check_arguments, each, file_path, instance
from carina.disk import read_regular_text, write_whole
from carina.errors import TrackingError, VolumeImportError, check_type
from carina.track.tree.airway_tree import AirwayTree
from carina.volume import Note

# A tree of 1000 branches has less than 5 MB; a much larger file is not a tree.
MAX_BYTES = 200_000_000


@check_arguments(
    path=file_path(),
    tree=instance(AirwayTree, "get it from carina.find_airways"),
    badges=each(instance(Note, "create a carina.volume.Note")),
)
def write_tree(path: Path | str, tree: AirwayTree, *, badges: Sequence[Note] = ()) -> Path:
    """Write a tree as JSON, whole or not at all.

    Parameters
    ----------
    path
        File to be written.
    tree
        The tree.
    badges
        Lasting notes of its case (``carina.volume.badges_of``), written under ``badges``.

    Raises
    ------
    DiskError
        If the folder is missing or not writable, or the disk is full; a former file stays unchanged.

    Examples
    --------
    >>> import carina
    >>> phantom = carina.generate_phantom(spacing_mm=3.0, generations=3)
    >>> airways = carina.find_airways(phantom.volume)
    >>> carina.write_tree("airways.json", airways.tree).name
    'airways.json'
    """
    check_type("write_tree", "tree", tree, AirwayTree, "get it from carina.find_airways")
    document = dataclasses.replace(tree, notes=tuple(dict.fromkeys([*badges, *tree.notes]))).to_json()
    text = json.dumps(document, allow_nan=False) + "\n"
    return write_whole(path, text.encode(), what="the tree")


@check_arguments(path=file_path())
def read_tree(path: Path | str) -> AirwayTree:
    """Read a tree from JSON.

    Raises
    ------
    VolumeImportError
        If the file cannot be read or is not an airway tree; the message states the file and the error.

    Examples
    --------
    >>> import carina
    >>> phantom = carina.generate_phantom(spacing_mm=3.0, generations=3)
    >>> airways = carina.find_airways(phantom.volume)
    >>> path = carina.write_tree("airways.json", airways.tree)
    >>> len(carina.read_tree(path)) == len(airways.tree)
    True
    """
    return _read(path)


def read_badges(path: Path | str) -> tuple[Note, ...]:
    """Return the lasting notes in a tree file; empty if it has none.

    Raises
    ------
    VolumeImportError
        As for :func:`read_tree`.
    """
    return _read(path).notes


def _read(path: Path | str) -> AirwayTree:
    source = Path(path)
    try:
        try:
            text = read_regular_text(source, max_bytes=MAX_BYTES)
        except VolumeImportError as error:
            if error.code != "disk.too-large":
                raise
            msg = f"{source}: too large for an airway tree ({source.stat().st_size} bytes)"
            raise VolumeImportError(msg, code="track.tree-format") from None
        document = json.loads(text, parse_constant=_refuse_nan)
        return AirwayTree.from_json(document)
    except OSError as error:
        if isinstance(error, VolumeImportError):
            raise
        msg = f"{source}: cannot be read: {error.strerror or error}"
        raise VolumeImportError(msg, code="track.tree-format") from error
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        msg = f"{source}: not JSON ({error}); expected an airway tree file written by carina"
        raise VolumeImportError(msg, code="track.tree-format") from error
    except (TrackingError, ValueError, KeyError, TypeError, OverflowError) as error:
        msg = f"{source}: {error}"
        raise VolumeImportError(msg, code="track.tree-format") from error


def _refuse_nan(name: str) -> None:
    msg = f"{name} is not a number in JSON"
    raise ValueError(msg)
