"""Carina: an open virtual bronchoscopy workstation.

The public functions, handed on from the parts that own them (loaded on first use, so that ``import carina`` is quick)::

    import carina

    volume = carina.open_volume("scan_folder")
    airways = carina.find_airways(volume)
    route = airways.tree.route_to(airways.tree.tips()[0].id)
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from carina.version import VERSION

__version__ = VERSION

if TYPE_CHECKING:
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
    from carina.track import Airways, AirwayTree, edit_airways, find_airways, track_paths, wall_field
    from carina.volume import Volume, demo_patient, inspect_path, open_mask, open_volume

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


def __getattr__(name: str) -> Any:
    home = _HOME.get(name)
    if home is None:
        msg = f"module 'carina' has no attribute {name!r}"
        raise AttributeError(msg)
    return getattr(importlib.import_module(f"carina.{home}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
