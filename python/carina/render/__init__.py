"""Rendering: transfer functions, views, and the single-machine renderer."""

from typing import Any

from carina import _core
from carina._core import CancelToken
from carina.render.appearance import Appearance
from carina.render.backend import Adapter, Backend, Verdict, find_adapters
from carina.render.lettering import PathSpan, letter_edges, mark_path
from carina.render.pictures import VIEW_NAMES, mark_tip, render_surface, render_view, view_spec
from carina.render.png_text import read_png_badges, read_png_pose
from carina.render.renderer import Renderer, can_cut
from carina.render.structures import build_isoregion_map, project_maximum, sample_plane
from carina.render.surface import Hit, Surface
from carina.render.transfer import PRESETS, Light, TransferFunction, transfer_from_histogram, transfer_preset
from carina.render.views import (
    AirwayView,
    CutPlaneView,
    DrrView,
    PathView,
    Picture,
    PictureLines,
    RenderStats,
    Slab,
    SliceView,
    TreeView,
    TriPlaneView,
    View,
    XrayView,
)

__all__ = [
    "PRESETS",
    "VIEW_NAMES",
    "Adapter",
    "AirwayView",
    "Appearance",
    "Backend",
    "CancelToken",
    "CutPlaneView",
    "DrrView",
    "Hit",
    "Light",
    "PathSpan",
    "PathView",
    "Picture",
    "PictureLines",
    "RenderStats",
    "Renderer",
    "Slab",
    "SliceView",
    "Surface",
    "TransferFunction",
    "TreeView",
    "TriPlaneView",
    "Verdict",
    "View",
    "XrayView",
    "build_info",
    "build_isoregion_map",
    "can_cut",
    "find_adapters",
    "letter_edges",
    "mark_path",
    "mark_tip",
    "project_maximum",
    "read_png_badges",
    "read_png_pose",
    "render_surface",
    "render_view",
    "sample_plane",
    "transfer_from_histogram",
    "transfer_preset",
    "view_spec",
]


def build_info() -> dict[str, Any]:
    """What the compiled module is: ``version``, ``profile``, ``simd`` (kernels used), ``threads``, ``target``."""
    return {**_core.build_info(), "simd": _core.best_instruction_set()}
