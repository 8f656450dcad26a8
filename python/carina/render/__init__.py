"""Rendering: transfer functions, views, and the single-machine renderer."""

from typing import Any

from carina import _core
from carina._core import CancelToken
from carina.render.appearance import Appearance, DecorationName
from carina.render.array_functions import (
    build_isoregion_map,
    isoregion_labels,
    isoregion_map,
    project_maximum,
    sample_plane,
)
from carina.render.cluster_machines import ClusterState, ClusterStatus, Machine, MemberStatus, Processor
from carina.render.isoregion_file import isoregion_note, open_isoregion_map
from carina.render.picture_text import PathSpan, letter_edges, mark_path
from carina.render.pictures import ignored_settings, mark_tip, render_surface, render_view, view_spec
from carina.render.png_text import read_png_badges, read_png_pose
from carina.render.processor_choice import Adapter, AdapterMeasurement, Backend, find_adapters
from carina.render.renderer import Renderer, can_cut
from carina.render.surface import Hit, Surface
from carina.render.thread_reservation import picture_threads, reserved_thread
from carina.render.transfer_function import PRESETS, Light, TransferFunction, transfer_from_histogram, transfer_preset
from carina.render.view_settings import ViewSettings
from carina.render.view_table import (
    CELLS,
    FINDER_VIEW,
    LEAD_VIEW,
    VIEW_NAMES,
    VIEWS,
    Cell,
    FlatViewName,
    Need,
    OrbitViewName,
    ViewName,
    ViewRow,
    view_row,
)
from carina.render.view_values import Carm, FlatPlace, GreyWindow, Orbit, Reformation, Sight, Slab
from carina.render.views import (
    AirwayView,
    CutPlaneView,
    DrrView,
    PathView,
    Picture,
    PictureLines,
    RenderStats,
    SliceView,
    TreeView,
    TriPlaneView,
    View,
    XrayView,
)
from carina.render.xray_set import XRAY_AXES, XraySet, render_xray_set

__all__ = [
    "CELLS",
    "FINDER_VIEW",
    "LEAD_VIEW",
    "PRESETS",
    "VIEWS",
    "VIEW_NAMES",
    "XRAY_AXES",
    "Adapter",
    "AdapterMeasurement",
    "AirwayView",
    "Appearance",
    "Backend",
    "CancelToken",
    "Carm",
    "Cell",
    "ClusterState",
    "ClusterStatus",
    "CutPlaneView",
    "DecorationName",
    "DrrView",
    "FlatPlace",
    "FlatViewName",
    "GreyWindow",
    "Hit",
    "Light",
    "Machine",
    "MemberStatus",
    "Need",
    "Orbit",
    "OrbitViewName",
    "PathSpan",
    "PathView",
    "Picture",
    "PictureLines",
    "Processor",
    "Reformation",
    "RenderStats",
    "Renderer",
    "Sight",
    "Slab",
    "SliceView",
    "Surface",
    "TransferFunction",
    "TreeView",
    "TriPlaneView",
    "View",
    "ViewName",
    "ViewRow",
    "ViewSettings",
    "XraySet",
    "XrayView",
    "build_info",
    "build_isoregion_map",
    "can_cut",
    "find_adapters",
    "ignored_settings",
    "isoregion_labels",
    "isoregion_map",
    "isoregion_note",
    "letter_edges",
    "mark_path",
    "mark_tip",
    "open_isoregion_map",
    "picture_threads",
    "project_maximum",
    "read_png_badges",
    "read_png_pose",
    "render_surface",
    "render_view",
    "render_xray_set",
    "reserved_thread",
    "sample_plane",
    "transfer_from_histogram",
    "transfer_preset",
    "view_row",
    "view_spec",
]


def build_info() -> dict[str, Any]:
    """Return facts on the compiled module: ``version``, ``profile``, ``simd`` (kernels), ``threads``, ``target``."""
    return {**_core.build_info(), "simd": _core.best_instruction_set()}
