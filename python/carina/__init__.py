"""Carina: an open virtual bronchoscopy workstation. Find, measure and show the airways of a chest CT.

Example::

    import carina

    volume = carina.open_volume("scan_folder")
    airways = carina.find_airways(volume)
    branches = carina.measure_tree(volume, airways).to_pandas()
    route = airways.tree.route_to(airways.tree.tips()[0].id)
    mesh = carina.track.lumen_mesh(volume, airways)

Every object below is loaded on first use. ``help(carina.NAME)`` documents one of them, ``help("carina.PART")`` a part.

Scans (``carina.volume``, ``carina.phantom``, ``carina.deidentification``, ``carina.pacs``)
    open_volume         Open a CT (DICOM, archive, NIfTI, NRRD, MetaImage) as a Volume; demo_patient opens Carina's own
    open_mask           Open a segmentation
    inspect_path        List the series in a path without opening them
    deidentify          Write DICOM images without identity (``carina.pacs`` retrieves images from a PACS)
    generate_phantom    Generate a chest CT with known airways; generate_mr_phantom an MR picture; write_phantom
    breathing           Breathing and cough as a deformation of the chest, for pictures, wall, tree and contact
    insert_nodule       Insert a nodule into a CT for training (``carina.training``)

Airways (``carina.track``)
    find_airways        Find the lumen, the tree and the names of its branches
    edit_airways        Add, cut, bridge, rename or smooth branches
    track_paths         Compute least-cost paths to targets
    measure_tree        Measure every branch: diameters, wall, stenoses
    wall_field          Compute the distance to the wall for a scope
    Airways, AirwayTree, WallField

Planning (``carina.plan``)
    grow_nodule         Segment a nodule from one point
    plan_route          Return the Plan of routes to a Nodule, with a verdict for each instrument

Pictures and movement (``carina.render``, ``carina.navigate``, ``carina.scopes``)
    render_view         Render one picture of a view; render_surface one of a mesh
    isoregion_map       Compute the IsoRegion map of a scan
    score_recording     Score a recorded flight (``carina.training``)
    Renderer, TransferFunction, transfer_preset, Pose, FlightPath, Navigator, ScopeDrive

Files (``carina.export``)
    export_airways      Write the tree, the lumen or its surface
    write_tree          Write a tree; read_tree reads one
    write_film          Write a flight as a video

Cases (``carina.session``, ``carina.commands``, ``carina.case``)
    Case, show          An open case with undo, history and pictures; linked views of it in a notebook

Rendering on several machines: ``help("carina.cluster")``

Errors (``carina.errors``)
    CarinaError         Base of all errors, each with a stable code: UsageError, VolumeImportError, NoResultError
"""

from __future__ import annotations

import sys

import lazy_loader

from carina.version import VERSION

__version__ = VERSION

# The public names and their modules are listed in __init__.pyi, which type checkers read too.
_load, __dir__, _PUBLIC = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    # If pydoc found __all__, help(carina) would show 2,700 lines of methods instead of the page of contents above.
    if name == "__all__" and sys._getframe(1).f_globals.get("__name__") != "pydoc":
        return _PUBLIC
    return _load(name)
