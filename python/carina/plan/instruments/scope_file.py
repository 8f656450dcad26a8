"""User's own bronchoscope, read from a file."""

from __future__ import annotations

from pathlib import Path
from typing import Any, get_args

from carina.plan.instruments.instrument_file import UserFile
from carina.scopes import ScopePreset
from carina.scopes.library import ScopeClass

FORMAT, VERSION = "carina-scope", 1
NAMES = (
    "name",
    "title",
    "scope_class",
    "tip_mm",
    "tube_mm",
    "channel_mm",
    "fov_deg",
    "focus_mm",
    "flexion_deg",
    "length_mm",
    "basis",
    "view_up_deg",
    "rigid_tip_mm",
    "bending_mm",
    "bend_radius_mm",
)
# Minimum and largest diameter in mm of a scope that the mechanical model accepts (crates/scope, body.rs).
MIN_TIP_MM, MAX_TIP_MM = 1.4, 7.8
MAX_FLEXION_DEG = 229.0
BENDING_MM, RIGID_MM, LENGTH_MM = (10.0, 100.0), (2.0, 20.0), (100.0, 1000.0)


def scope_from_file(path: str | Path) -> ScopePreset:
    """Read the user's own bronchoscope from a JSON file in the format of `scope_to_json`; null or missing is unknown.

    The generic lens is used, because no manufacturer publishes the data of its lenses.

    Raises
    ------
    UsageError
        If the file cannot be read or contains impossible values. The message states the file, the field, the expected
        and the found value (code ``plan.own-file``).
    """
    file = UserFile.read(path)
    file.check(FORMAT, VERSION, NAMES)
    scope_class = file.text("scope_class")
    if scope_class not in get_args(ScopeClass):
        raise file.refusal("scope_class", f"one of {', '.join(get_args(ScopeClass))}", scope_class)
    tip_mm = file.size("tip_mm", MAX_TIP_MM)
    if tip_mm < MIN_TIP_MM:
        raise file.refusal("tip_mm", f"{MIN_TIP_MM:g} to {MAX_TIP_MM:g} mm", tip_mm)
    tube_mm, channel_mm = file.number_or_none("tube_mm", MAX_TIP_MM), file.number_or_none("channel_mm", MAX_TIP_MM)
    if tube_mm is not None and tube_mm < MIN_TIP_MM:
        raise file.refusal("tube_mm", f"{MIN_TIP_MM:g} to {MAX_TIP_MM:g} mm, or null", tube_mm)
    if channel_mm is not None and channel_mm >= tip_mm:
        raise file.refusal("channel_mm", f"less than the tip's {tip_mm:g} mm", channel_mm)
    return ScopePreset(
        name=file.text("name"),
        title=file.text("title"),
        scope_class=scope_class,  # type: ignore[arg-type]
        tip_mm=tip_mm,
        tube_mm=tube_mm,
        channel_mm=channel_mm,
        fov_deg=file.number_or_none("fov_deg", 170.0),
        focus_mm=file.pair_or_none("focus_mm", 500.0),
        flexion_deg=file.pair_or_none("flexion_deg", MAX_FLEXION_DEG),
        length_mm=_within(file, "length_mm", LENGTH_MM),
        basis=file.text("basis"),
        view_up_deg=file.number_or_none("view_up_deg", 90.0) or 0.0,
        rigid_tip_mm=_within(file, "rigid_tip_mm", RIGID_MM),
        bending_mm=_pair_within(file, "bending_mm", BENDING_MM),
        bend_radius_mm=file.pair_or_none("bend_radius_mm", 100.0),
    )


def scope_to_json(scope: ScopePreset) -> dict[str, Any]:
    """Return a scope as plain JSON types, which `scope_from_file` reads."""
    values = {name: getattr(scope, name) for name in NAMES}
    return {
        "format": FORMAT,
        "version": VERSION,
        **{name: list(value) if isinstance(value, tuple) else value for name, value in values.items()},
    }


def _within(file: UserFile, name: str, limits: tuple[float, float]) -> float | None:
    found = file.number_or_none(name, limits[1])
    if found is not None and found < limits[0]:
        raise file.refusal(name, f"{limits[0]:g} to {limits[1]:g} mm, or null", found)
    return found


def _pair_within(file: UserFile, name: str, limits: tuple[float, float]) -> tuple[float, float] | None:
    found = file.pair_or_none(name, limits[1])
    if found is not None and not limits[0] <= found[0] <= found[1]:
        raise file.refusal(name, f"two numbers from {limits[0]:g} to {limits[1]:g} mm, the shorter first", list(found))
    return found
