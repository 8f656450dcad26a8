"""``tree.json``: the airway tree as a file (DESIGN section 3)."""

from __future__ import annotations

import contextlib
import json
import os
import tempfile
from pathlib import Path

from carina.errors import CarinaError, TrackingError, VolumeImportError
from carina.track.tree import AirwayTree

__all__ = ["read_tree", "write_tree"]

# A tree of 1000 branches is below 5 MB; anything much larger is another file.
MAX_BYTES = 200_000_000


def write_tree(path: Path | str, tree: AirwayTree) -> Path:
    """Write a tree as JSON, whole or not at all.

    Raises
    ------
    CarinaError
        If the folder is missing or not writable, or the disk is full; what was there before stays.
    """
    target = Path(path)
    text = json.dumps(tree.to_json(), allow_nan=False) + "\n"
    try:
        descriptor, draft = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.", suffix=".part")
        try:
            with os.fdopen(descriptor, "w", encoding="utf-8") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
            # mkstemp makes a file that only its owner reads; a result has the permissions of any new file.
            mask = os.umask(0)
            os.umask(mask)
            Path(draft).chmod(0o666 & ~mask)
            Path(draft).replace(target)
        except BaseException:
            with contextlib.suppress(OSError):
                Path(draft).unlink()
            raise
    except OSError as error:
        msg = f"cannot write the tree to {target}: {error.strerror or error}"
        raise CarinaError(msg, code="export.write") from error
    return target


def read_tree(path: Path | str) -> AirwayTree:
    """Read a tree from JSON.

    Raises
    ------
    VolumeImportError
        If the file cannot be read or is not an airway tree; the message names it and says what is wrong.
    """
    source = Path(path)
    try:
        if source.stat().st_size > MAX_BYTES:
            msg = f"{source}: too large for an airway tree ({source.stat().st_size} bytes)"
            raise VolumeImportError(msg, code="track.tree-format")
        document = json.loads(source.read_text(encoding="utf-8"), parse_constant=_no_nan)
        return AirwayTree.from_json(document)
    except OSError as error:
        if isinstance(error, VolumeImportError):
            raise
        msg = f"{source}: cannot be read: {error.strerror or error}"
        raise VolumeImportError(msg, code="track.tree-format") from error
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        msg = f"{source}: is not JSON ({error}); expected a file that carina wrote with -o tree.json"
        raise VolumeImportError(msg, code="track.tree-format") from error
    except (TrackingError, ValueError) as error:
        msg = f"{source}: {error}"
        raise VolumeImportError(msg, code="track.tree-format") from error


def _no_nan(name: str) -> None:
    msg = f"{name} is not a number in JSON"
    raise ValueError(msg)
