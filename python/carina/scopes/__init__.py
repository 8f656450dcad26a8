"""Bronchoscopes: pose of the tip, lens, library of instruments, and movement in the airways."""

from carina.scopes.calibration import lens_from_file, lens_from_text
from carina.scopes.drive import Contact, ContactRecord, ScopeDrive, ScopeHold, ScopeLimit, ScopeState, lever_flexion
from carina.scopes.fit import FittedOptics, Residual, fit_generic_optics
from carina.scopes.lens import (
    FULL_FRAME,
    OUTLINES,
    PINHOLE,
    Calibration,
    DepthOfField,
    ImageField,
    Lens,
    Optics,
    Outline,
)
from carina.scopes.library import DEFAULT_SCOPE, FIT_MARGIN_MM, ScopePreset, scope_preset, scope_presets
from carina.scopes.moved_scope import scope_in_moved_patient
from carina.scopes.path_frames import PathFrames
from carina.scopes.pose import Pose, upright
from carina.scopes.wall_field import WallField

__all__ = [
    "DEFAULT_SCOPE",
    "FIT_MARGIN_MM",
    "FULL_FRAME",
    "OUTLINES",
    "PINHOLE",
    "Calibration",
    "Contact",
    "ContactRecord",
    "DepthOfField",
    "FittedOptics",
    "ImageField",
    "Lens",
    "Optics",
    "Outline",
    "PathFrames",
    "Pose",
    "Residual",
    "ScopeDrive",
    "ScopeHold",
    "ScopeLimit",
    "ScopePreset",
    "ScopeState",
    "WallField",
    "fit_generic_optics",
    "lens_from_file",
    "lens_from_text",
    "lever_flexion",
    "scope_in_moved_patient",
    "scope_preset",
    "scope_presets",
    "upright",
]
