"""Cache of phantoms, airways and other test data that are slow to compute, shared by all test processes.

A phantom takes seconds to generate and milliseconds to read. It is stored in pytest's cache folder under a digest of
its options, of the compiled core and of the sources that generate it. Data of other code versions are never read, and
are deleted when the first phantom of the present version is stored. Within one process a repeated request returns the
same object. All arrays are read-only.
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
from carina.scopes import WallField
from carina.track import Airways, AirwayTree
from carina.track.paths.path_grid import PathGrid
from carina.track.paths.rebuilt_tracker import CoreRecipe
from carina.track.paths.tracker import PathTracker
from carina.volume import Volume, ct_digest, model
from run_cleanup import run_name

ROOT = Path(__file__).resolve().parents[1]
SEARCH = carina.find_airways
"""Carina's own search, which the test cache calls because tests replace ``carina.find_airways`` by the cache."""
CACHE = ROOT / ".pytest_cache" / "d" / "made"
"""Folder of the cache, beside the caches of pytest's plugins; ``pytest --cache-clear`` empties it."""


MASKED_CHEST: dict[str, Any] = {"seed": 1, "spacing_mm": 1.1, "noise_hu": 25.0}
"""Options of a chest for several test files: all generations, and fine enough for named segments."""
OTHER_CHEST: dict[str, Any] = {"seed": 2, "spacing_mm": 1.1}
"""Options of a second chest, with other anatomy and less noise."""
# Options of a chest with the central airways only.
SMALL_CHEST: dict[str, Any] = {"seed": 4, "spacing_mm": 1.2, "generations": 4}
COARSE_CHEST: dict[str, Any] = {"seed": 4, "spacing_mm": 1.6, "generations": 4, "noise_hu": 25.0}
"""Options of a chest with the central airways, for searches of paths in all voxels."""


@cache
def digest_of_the_code() -> str:
    """Return a digest of the code that determines the voxels, the geometry and the ground truth of a phantom."""
    found = hashlib.sha256(f"{sys.version} numpy {np.__version__}".encode())
    files = [_core.__file__, model.__file__, sys.modules[__name__].__file__]
    for path in (*map(str, files), *sorted(map(str, Path(*phantom.__path__).glob("*.py")))):
        found.update(Path(path).read_bytes())
    return found.hexdigest()[:16]


def cached_phantom(**options: Any) -> Phantom:
    """Return :func:`carina.phantom.generate_phantom` with these options, from the cache if it is stored there."""
    return _phantom(json.dumps(options, sort_keys=True))


@lru_cache(maxsize=8)
def _phantom(options: str) -> Phantom:
    name = hashlib.sha256(options.encode()).hexdigest()[:16]
    folder = CACHE / digest_of_the_code() / name
    try:
        with alone(name):
            if not folder.exists():
                store_phantom(phantom.generate_phantom(**json.loads(options)), folder)
    except OSError:  # The checkout cannot be written, so the phantom is generated each time.
        return phantom.generate_phantom(**json.loads(options))
    # The arrays are memory-mapped, so that workers share the memory.
    values, lumen = (np.asarray(np.load(folder / f"{part}.npy", mmap_mode="r")) for part in ("ct", "lumen"))
    with (folder / "rest.pickle").open("rb") as file:
        rest = pickle.load(file)
    volume = Volume(values, rest["lps_from_ijk"], source=rest["source"])
    upper = np.asarray(np.load(folder / "upper.npy", mmap_mode="r")) if (folder / "upper.npy").exists() else None
    return Phantom(volume=volume, lumen_zyx=lumen, truth=rest["truth"], upper_airway_zyx=upper)


def store_phantom(made: Phantom, folder: Path) -> None:
    """Write a phantom to a draft folder and rename it, so that an interrupted run leaves no incomplete phantom."""
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
    """Return a digest of all code that determines the results of the package."""
    found = hashlib.sha256(digest_of_the_code().encode())
    package = Path(carina.__file__).parent
    for path in sorted(package.rglob("*.py")):
        found.update(f"{path.relative_to(package)}".encode() + path.read_bytes())
    return found.hexdigest()[:16]


def cached_value(name: str, make: Callable[[], Any]) -> Any:
    """Return the result of ``make``, pickled under this name until the code of the package changes."""
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
    except OSError:  # The checkout cannot be written, so the value is computed each time.
        return make()


@contextlib.contextmanager
def alone(name: str) -> Iterator[None]:
    """Let only one process at a time execute the block ``name``; without file locks all processes enter."""
    CACHE.mkdir(parents=True, exist_ok=True)
    try:
        import fcntl
    except ImportError:
        yield
        return
    with (CACHE / f"{name}.lock").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def stored_airways(name: str, volume: Volume) -> Airways:
    """Return the airways of a volume from the cache; the first process that needs them searches for them.

    The path tracker is not stored. It is computed again when the first path is requested, as for an opened case.
    """
    searched: list[Airways] = []

    def search() -> tuple[dict[str, Any], Any]:
        found = SEARCH(volume)
        searched.append(found)
        # The tracker and the evidence contain locks and compiled objects; the other fields are plain values.
        fields = {one.name: getattr(found, one.name) for one in dataclasses.fields(found)}
        del fields["tracker"], fields["evidence"]
        fields["tree"] = (found.tree.branches, found.tree.notes)
        tracker, grid = found.tracker, found.tracker.grid
        paths_zyx = tracker.lumen_zyx if grid.is_divided else None
        return fields, (grid.parts, paths_zyx, tracker.root_ijk, tracker.given_nodes)

    fields, (parts, paths_zyx, root_ijk, nodes) = cached_value(name, search)
    if searched:
        return searched[0]
    (branches, notes), lumen, levels = fields.pop("tree"), fields["lumen_zyx"], fields["wall_levels"]
    for array in (lumen, paths_zyx, fields["upper_airway_zyx"]):
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
    return Airways(tree=AirwayTree(branches, notes=notes, _smooth=tracker.smooth), tracker=tracker, **fields)


_FOUND: dict[str, Airways] = {}


def name_of(volume: Volume) -> str:
    """Return a name of a volume's voxels and geometry, for stored results."""
    place = hashlib.sha256(volume.lps_from_ijk.tobytes() + repr((volume.shape_zyx, volume.is_hu)).encode()).hexdigest()
    return f"{ct_digest(volume)[:16]}-{place[:8]}"


def found_airways(volume: Volume) -> Airways:
    """Return the airways of a volume; all volumes with equal voxels and geometry have the same object."""
    name = f"airways of {name_of(volume)}"
    if name not in _FOUND:
        _FOUND[name] = stored_airways(name, volume)
    return _FOUND[name]


@lru_cache(maxsize=4)
def _airways(options: str) -> Airways:
    volume = _phantom(options).volume
    return stored_airways(f"airways of {name_of(volume)}", volume)


def cached_airways(**options: Any) -> Airways:
    """Return the airways of :func:`cached_phantom`, searched once for all workers."""
    return _airways(json.dumps(options, sort_keys=True))


@cache
def masked_chest() -> tuple[Volume, Airways, WallField]:
    """Return the CT of :data:`MASKED_CHEST`, its airways and its wall, which is computed once for each worker.

    The wall has the coarsest samples, which are enough for scores of flights and twice as fast.
    """
    volume, airways = cached_phantom(**MASKED_CHEST).volume, cached_airways(**MASKED_CHEST)
    return volume, airways, carina.wall_field(volume, airways, spacing_mm=0.6, progress=False)


@cache
def patient() -> tuple[Volume, Airways]:
    """Return the bundled CT and its airways, searched once for all workers."""
    volume = carina.demo_patient()
    return volume, stored_airways("airways of the patient", volume)
