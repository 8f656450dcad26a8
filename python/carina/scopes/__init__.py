"""The bronchoscope: where its tip is (pose), how it sees (lens), and which instruments there are (library)."""

from carina.scopes.calibration import lens_from_file, lens_from_text
from carina.scopes.fit import FittedOptics, Residual, fit_generic_optics
from carina.scopes.lens import (
    FULL_FRAME,
    MASKS,
    PINHOLE,
    Calibration,
    DepthOfField,
    ImageField,
    Lens,
    Mask,
    Optics,
)
from carina.scopes.library import DEFAULT_SCOPE, FIT_MARGIN_MM, ScopePreset, scope_preset, scope_presets
from carina.scopes.path_frames import PathFrames
from carina.scopes.pose import Pose, upright

__all__ = [
    "DEFAULT_SCOPE",
    "FIT_MARGIN_MM",
    "FULL_FRAME",
    "MASKS",
    "PINHOLE",
    "Calibration",
    "DepthOfField",
    "FittedOptics",
    "ImageField",
    "Lens",
    "Mask",
    "Optics",
    "PathFrames",
    "Pose",
    "Residual",
    "ScopePreset",
    "fit_generic_optics",
    "lens_from_file",
    "lens_from_text",
    "scope_preset",
    "scope_presets",
    "upright",
]
