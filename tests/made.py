"""What is slow to make and the same for many tests: made once by whoever needs it first, then read by all workers.

A phantom takes seconds to make and a moment to read. It lies in pytest's cache folder under a digest of its options, of
the compiled core and of the sources that make it: what was made by other code is never read, and goes with the first
phantom that is made by this one. What a test asks for twice in one process is the same object; all of it is read-only.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import pickle
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

import carina
from carina import _core, phantom
from carina.phantom import Phantom
from carina.track import Airways, AirwayTree
from carina.track.paths.path_grid import PathGrid
from carina.track.paths.rebuilt import CoreRecipe
from carina.track.paths.tracker import PathTracker
from carina.volume import Volume, ct_digest, model
from run_cleanup import run_name

ROOT = Path(__file__).resolve().parents[1]
SEARCH = carina.find_airways
"""The search itself: tests put what was found here in its place, and one that called itself would wait for itself."""
CACHE = ROOT / ".pytest_cache" / "d" / "made"
"""Where pytest's own plugins keep theirs; ``pytest --cache-clear`` empties it."""


# Chests that several files look at. All the generations there are, fine enough for the named segments.
MASKED_CHEST: dict[str, Any] = {"seed": 1, "spacing_mm": 1.1, "noise_hu": 25.0}
OTHER_CHEST: dict[str, Any] = {"seed": 2, "spacing_mm": 1.1}
# The central airways alone.
SMALL_CHEST: dict[str, Any] = {"seed": 4, "spacing_mm": 1.2, "generations": 4}


@cache
def digest_of_the_code() -> str:
    """Of everything that has a say in a phantom's voxels, its place and its truth."""
    found = hashlib.sha256(f"{sys.version} numpy {np.__version__}".encode())
    for module in (_core, phantom, model, sys.modules[__name__]):
        assert module.__file__ is not None
        found.update(Path(module.__file__).read_bytes())
    return found.hexdigest()[:16]


def made_phantom(**options: Any) -> Phantom:
    """:func:`carina.phantom.generate_phantom` with these options, read from the cache where it was made before."""
    return _phantom(json.dumps(options, sort_keys=True))


@lru_cache(maxsize=8)
def _phantom(options: str) -> Phantom:
    name = hashlib.sha256(options.encode()).hexdigest()[:16]
    folder = CACHE / digest_of_the_code() / name
    try:
        with alone(name):
            if not folder.exists():
                keep(phantom.generate_phantom(**json.loads(options)), folder)
    except OSError:  # a checkout that cannot be written: costs time only
        return phantom.generate_phantom(**json.loads(options))
    # Mapped, not read: the workers share the memory.
    values, lumen = (np.asarray(np.load(folder / f"{part}.npy", mmap_mode="r")) for part in ("ct", "lumen"))
    with (folder / "rest.pickle").open("rb") as file:
        rest = pickle.load(file)
    volume = Volume(values, rest["lps_from_ijk"], source=rest["source"])
    upper = np.asarray(np.load(folder / "upper.npy", mmap_mode="r")) if (folder / "upper.npy").exists() else None
    return Phantom(volume=volume, lumen_zyx=lumen, truth=rest["truth"], upper_airway_zyx=upper)


def keep(made: Phantom, folder: Path) -> None:
    """Write beside its place and rename, so that a run that is stopped leaves nothing half done."""
    assert made.lumen_distance_mm is None
    for other in CACHE.iterdir():
        if other.is_dir() and other != folder.parent:
            shutil.rmtree(other, ignore_errors=True)
    folder.parent.mkdir(exist_ok=True)
    draft = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f"draft-{run_name()}-"))
    np.save(draft / "ct.npy", made.volume.hu_zyx)
    np.save(draft / "lumen.npy", made.lumen_zyx)
    if made.upper_airway_zyx is not None:
        np.save(draft / "upper.npy", made.upper_airway_zyx)
    rest = {"lps_from_ijk": made.volume.lps_from_ijk, "source": made.volume.source, "truth": made.truth}
    (draft / "rest.pickle").write_bytes(pickle.dumps(rest))
    draft.rename(folder)


@cache
def digest_of_the_package() -> str:
    """Of everything that has a say in what the package finds."""
    found = hashlib.sha256(digest_of_the_code().encode())
    package = Path(carina.__file__).parent
    for path in sorted(package.rglob("*.py")):
        found.update(f"{path.relative_to(package)}".encode() + path.read_bytes())
    return found.hexdigest()[:16]


def made_value(name: str, make: Callable[[], Any]) -> Any:
    """What ``make`` gives, pickled under this name for as long as no line of the package changes."""
    folder = CACHE / digest_of_the_code()
    path = folder / f"{name}, {digest_of_the_package()}.pickle"
    try:
        with alone(name):
            if not path.exists():
                folder.mkdir(exist_ok=True)
                for old in folder.glob(f"{name}, *.pickle"):
                    old.unlink()
                draft = path.with_suffix(f".draft-{run_name()}")
                draft.write_bytes(pickle.dumps(make()))
                draft.rename(path)
            return pickle.loads(path.read_bytes())
    except OSError:  # a checkout that cannot be written: costs time only
        return make()


@contextlib.contextmanager
def alone(name: str) -> Iterator[None]:
    """One process at a time makes what has this name; the others wait. Without locks of files they all make it."""
    CACHE.mkdir(parents=True, exist_ok=True)
    try:
        import fcntl
    except ImportError:
        yield
        return
    with (CACHE / f"{name}.lock").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def kept_airways(name: str, volume: Volume) -> Airways:
    """What is found in a volume, searched by whoever needs it first; the others put it together again.

    Their tracker, which no file holds, is calculated anew where paths are first asked for, as that of a case is.
    """
    searched: list[Airways] = []

    def search() -> tuple[dict[str, Any], Any]:
        found = SEARCH(volume)
        searched.append(found)
        # A field of these holds locks and compiled parts; the rest are values.
        told = {one.name: getattr(found, one.name) for one in dataclasses.fields(found)}
        del told["tracker"], told["evidence"]
        told["tree"] = (found.tree.branches, found.tree.notes)
        tracker, grid = found.tracker, found.tracker.grid
        paths_zyx = tracker.lumen_zyx if grid.is_divided else None
        return told, (grid.parts, paths_zyx, tracker.root_ijk, tracker.given_nodes)

    told, (parts, paths_zyx, root_ijk, nodes) = made_value(name, search)
    if searched:
        return searched[0]
    (branches, notes), lumen, levels = told.pop("tree"), told["lumen_zyx"], told["wall_levels"]
    for array in (lumen, paths_zyx, told["upper_airway_zyx"]):
        if array is not None:
            array.flags.writeable = False
    grid = PathGrid(volume, parts)
    paths_zyx = lumen if paths_zyx is None else paths_zyx
    tracker = PathTracker(
        grid, None, recipe=CoreRecipe(levels, is_edited=False), root_ijk=root_ijk, lumen_zyx=paths_zyx
    )
    if nodes is None:
        tracker.follow_branches(branches)
    else:
        tracker.set_branches(branches, nodes)
    return Airways(tree=AirwayTree(branches, notes=notes, _smooth=tracker.smooth), tracker=tracker, **told)


_FOUND: dict[str, Airways] = {}


def found_airways(volume: Volume) -> Airways:
    """The airways of a volume, the same object for all with the same voxels in the same place."""
    place = hashlib.sha256(volume.lps_from_ijk.tobytes() + repr((volume.shape_zyx, volume.is_hu)).encode()).hexdigest()
    name = f"airways of {ct_digest(volume)[:16]}-{place[:8]}"
    if name not in _FOUND:
        _FOUND[name] = kept_airways(name, volume)
    return _FOUND[name]


@lru_cache(maxsize=4)
def _airways(options: str) -> Airways:
    name = hashlib.sha256(options.encode()).hexdigest()[:16]
    return kept_airways(f"airways of {name}", _phantom(options).volume)


def made_airways(**options: Any) -> Airways:
    """The airways that are found in :func:`made_phantom`, searched once for all workers."""
    return _airways(json.dumps(options, sort_keys=True))


@cache
def patient() -> tuple[Volume, Airways]:
    """The bundled CT and its airways, searched once for all workers."""
    volume = carina.demo_patient()
    return volume, kept_airways("airways of the patient", volume)
