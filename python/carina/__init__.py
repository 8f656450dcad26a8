"""Carina: an open virtual bronchoscopy workstation. Find, measure and show the airways of a chest CT.

Example::

    import carina

    volume = carina.open_volume("scan_folder")
    airways = carina.find_airways(volume)
    branches = carina.measure_tree(volume, airways).to_pandas()
    route = airways.tree.route_to(airways.tree.tips()[0].id)
    mesh = carina.track.lumen_mesh(volume, airways)

Every object below is loaded on first use. ``help(carina.NAME)`` documents one of them, ``help("carina.PART")`` a part.

Scans (``carina.volume``, ``carina.phantom``)
    open_volume         Open a CT: a DICOM folder, NIfTI, NRRD or MetaImage
    open_mask           Open a segmentation
    inspect_path        List the series in a path without opening them
    demo_patient        Open the CT that comes with Carina
    generate_phantom    Generate a chest CT with known airways; write_phantom writes one to a folder
    Volume              A CT in HU with its geometry

Airways (``carina.track``)
    find_airways        Find the lumen, the tree and the names of its branches
    edit_airways        Add, cut, bridge, rename or smooth branches
    track_paths         Compute least-cost paths to targets
    measure_tree        Measure every branch: diameters, wall, stenoses
    wall_field          Compute the distance to the wall for a scope
    Airways, AirwayTree, WallField

Planning (``carina.plan``)
    grow_nodule         Segment a nodule from one point
    plan_route          Plan routes to a nodule, with a verdict for each instrument
    Nodule, Plan

Pictures and movement (``carina.render``, ``carina.navigate``, ``carina.scopes``)
    render_view         Render one picture of a view
    render_surface      Render a picture of a mesh
    isoregion_map       Compute the IsoRegion map of a scan
    transfer_preset     Return a transfer function by name
    Renderer, TransferFunction, Pose, FlightPath, Navigator, ScopeDrive

Files (``carina.export``)
    export_airways      Write the tree, the lumen or its surface
    write_tree          Write a tree; read_tree reads one
    write_film          Write a flight as a video

Cases (``carina.session``, ``carina.commands``)
    Case                An open case with undo, history and pictures

Errors (``carina.errors``)
    CarinaError         Base of all errors; each has a stable code
    UsageError, VolumeImportError, NoResultError
"""

from __future__ import annotations

import sys
from importlib import import_module

from carina.version import VERSION

__version__ = VERSION

# Importing typing takes three quarters of the time of a bare import; type checkers know the name TYPE_CHECKING.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from carina import case as case
    from carina import cluster as cluster
    from carina import commands as commands
    from carina import errors as errors
    from carina import export as export
    from carina import navigate as navigate
    from carina import phantom as phantom
    from carina import plan as plan
    from carina import render as render
    from carina import scopes as scopes
    from carina import session as session
    from carina import track as track
    from carina import volume as volume
    from carina.errors import CarinaError, NoResultError, UsageError, VolumeImportError
    from carina.export import export_airways, read_tree, write_film, write_tree
    from carina.navigate import FlightPath, Navigator
    from carina.phantom import generate_phantom, write_phantom
    from carina.plan import Nodule, Plan, grow_nodule, plan_route
    from carina.render import (
        Renderer,
        TransferFunction,
        isoregion_map,
        render_surface,
        render_view,
        transfer_preset,
    )
    from carina.scopes import Pose, ScopeDrive, WallField
    from carina.session import Case
    from carina.track import Airways, AirwayTree, edit_airways, find_airways, measure_tree, track_paths, wall_field
    from carina.volume import Volume, demo_patient, inspect_path, open_mask, open_volume

_PARTS = frozenset(
    (
        "case",
        "cluster",
        "commands",
        "errors",
        "export",
        "navigate",
        "phantom",
        "plan",
        "render",
        "scopes",
        "session",
        "track",
        "volume",
    )
)
"""Names of the documented parts (``docs/api``), available as ``carina.track`` after ``import carina``."""
_HOME = {
    "AirwayTree": "track",
    "Airways": "track",
    "Case": "session",
    "CarinaError": "errors",
    "FlightPath": "navigate",
    "Navigator": "navigate",
    "NoResultError": "errors",
    "Nodule": "plan",
    "Plan": "plan",
    "Pose": "scopes",
    "Renderer": "render",
    "ScopeDrive": "scopes",
    "TransferFunction": "render",
    "UsageError": "errors",
    "Volume": "volume",
    "VolumeImportError": "errors",
    "WallField": "scopes",
    "demo_patient": "volume",
    "edit_airways": "track",
    "export_airways": "export",
    "find_airways": "track",
    "generate_phantom": "phantom",
    "grow_nodule": "plan",
    "plan_route": "plan",
    "inspect_path": "volume",
    "isoregion_map": "render",
    "measure_tree": "track",
    "open_mask": "volume",
    "open_volume": "volume",
    "read_tree": "export",
    "render_surface": "render",
    "render_view": "render",
    "track_paths": "track",
    "transfer_preset": "render",
    "wall_field": "track",
    "write_film": "export",
    "write_phantom": "phantom",
    "write_tree": "export",
}

__all__ = [
    "AirwayTree",
    "Airways",
    "CarinaError",
    "Case",
    "FlightPath",
    "Navigator",
    "NoResultError",
    "Nodule",
    "Plan",
    "Pose",
    "Renderer",
    "ScopeDrive",
    "TransferFunction",
    "UsageError",
    "Volume",
    "VolumeImportError",
    "WallField",
    "__version__",
    "demo_patient",
    "edit_airways",
    "export_airways",
    "find_airways",
    "generate_phantom",
    "grow_nodule",
    "inspect_path",
    "isoregion_map",
    "measure_tree",
    "open_mask",
    "open_volume",
    "plan_route",
    "read_tree",
    "render_surface",
    "render_view",
    "track_paths",
    "transfer_preset",
    "wall_field",
    "write_film",
    "write_phantom",
    "write_tree",
]


# Without __all__, pydoc documents only the contents of this file instead of 2,700 lines of methods.
_PUBLIC = __all__
del __all__


def __getattr__(name: str) -> Any:
    if name == "__all__" and sys._getframe(1).f_globals.get("__name__") != "pydoc":
        return _PUBLIC
    if name in _PARTS:
        return import_module(f"carina.{name}")
    home = _HOME.get(name)
    if home is None:
        msg = f"module 'carina' has no attribute {name!r}"
        raise AttributeError(msg)
    return getattr(import_module(f"carina.{home}"), name)


def __dir__() -> list[str]:
    return sorted({*_PUBLIC, *_PARTS})
