"""Library of instruments for the working channel of a scope, with the basis of each value.

The basis is as in the library of scopes: ``s`` was read in a source, ``k`` is common knowledge that was not checked
against the manufacturer's data. An unknown value is None, never a guess. `tool_from_file` reads the user's own
instruments.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from carina.display import one_line
from carina.errors import UsageError
from carina.plan.instruments.instrument_file import UserFile
from carina.scopes import ScopePreset

DEFAULT_TOOL = "needle-21g"
CLEARANCE_MM = 0.1
"""Minimum difference in mm between channel and tool diameter; a thicker tool does not pass (common knowledge)."""
ONLY_BRUSH = "no needle of the library passes its channel: the instrument can only brush, or take forceps in the lumen"
"""Text about a scope whose channel no needle passes."""
FORMAT, VERSION = "carina-tool", 1
_MAX = {"outer_mm": 10.0, "reach_mm": 100.0, "rigid_mm": 100.0, "flexion_loss_deg": 180.0}


@one_line
@dataclass(frozen=True, slots=True)
class Tool:
    """Instrument for the working channel of a scope; lengths in mm, None if unknown."""

    name: str
    title: str
    outer_mm: float
    """Diameter in mm that the working channel must let pass: for a needle, needle with sheath."""
    reach_mm: float
    """Distance in mm beyond the scope's tip at which the tool works.

    For a needle it is the throw, for a flexible tool the distance that it is pushed under vision.
    """
    pierces: bool
    """Whether the tool passes through the wall of an airway; other tools stay in the lumen."""
    rigid_mm: float | None
    """Length in mm of the longest part of the tool that does not bend; None if unknown."""
    basis: str
    """Basis of the tool's values: ``s`` (source), ``k`` (common knowledge), or a text with the basis of each."""
    source: str | None = None
    """Source of the values whose basis is ``s``; None if no value has a source."""
    flexion_loss_deg: float | None = None
    """Loss of the scope's greatest flexion with the tool in the channel, degrees."""

    def __post_init__(self) -> None:
        """Raise an error if a length of the tool or the loss of flexion is invalid."""
        for what, most in _MAX.items():
            value = getattr(self, what)
            needed = what in {"outer_mm", "reach_mm"}
            if value is None and not needed:
                continue
            if not (math.isfinite(value) and 0.0 <= value <= most and (value > 0.0 or not needed)):
                expected = f"above 0 up to {most:g}" if needed else f"0 to {most:g}"
                raise UsageError(f"{what}: expected {expected}; found {value}", code="plan.tool")

    def passes(self, channel_mm: float) -> bool:
        """Return whether the tool slides through a channel of this diameter."""
        return channel_mm - self.outer_mm >= CLEARANCE_MM - 1e-9

    def to_json(self) -> dict[str, Any]:
        """Return the tool as plain JSON types, which `tool_from_json` reads."""
        return {"format": FORMAT, "version": VERSION, **{one.name: getattr(self, one.name) for one in fields(self)}}


_GUIDED = (
    "radial EBUS with UM-S20-17S, K-201 and 1.5 mm forceps through a 2.0 mm channel: bio-protocol.org, id 19048772"
)
_CRYO_19 = "cryobiopsy with 1.1 and 1.9 mm probes: J Bras Pneumol 2022, PMC9970367"
_CRYO_17 = "cryobiopsy with 1.1 and 1.7 mm probes: Respir Res 2024, doi 10.1186/s12931-024-02700-w"
_DIAMETER = "diameter s, rest k"

# No tool has a value for the loss of flexion: publications compare tools with each other, in few scopes. A forceps
# reduced the flexion by up to 20.5 degrees more than a needle or a catheter (abstract in referencecitationanalysis.com,
# 5.1 and 6.2 mm scopes).
_TOOLS = (
    Tool("needle-21g", "Aspiration needle, 21 G", 1.8, 15.0, True, 15.0, "k"),
    Tool("needle-19g", "Aspiration needle, 19 G", 1.9, 15.0, True, 15.0, "k"),
    Tool("needle-18g", "Aspiration needle, 18 G", 1.9, 15.0, True, 15.0, "k"),
    Tool("needle-22g", "Aspiration needle, 22 G", 1.8, 15.0, True, 15.0, "k"),
    Tool("needle-21g-long", "Aspiration needle, 21 G, long throw", 1.8, 20.0, True, 20.0, "k"),
    Tool("forceps", "Biopsy forceps, 1.8 mm", 1.8, 30.0, False, 8.0, "k"),
    Tool("forceps-1.5", "Biopsy forceps, 1.5 mm", 1.5, 30.0, False, None, _DIAMETER, _GUIDED),
    Tool("brush", "Cytology brush", 1.4, 30.0, False, 10.0, "k"),
    Tool("cryoprobe-1.1", "Cryoprobe, 1.1 mm", 1.1, 30.0, False, None, _DIAMETER, _CRYO_19),
    Tool("cryoprobe-1.7", "Cryoprobe, 1.7 mm", 1.7, 30.0, False, None, _DIAMETER, _CRYO_17),
    Tool("cryoprobe-1.9", "Cryoprobe, 1.9 mm", 1.9, 30.0, False, None, _DIAMETER, _CRYO_19),
    Tool(
        "ultrasound-1.4",
        "Radial ultrasound probe, 1.4 mm (UM-S20-17S)",
        1.4,
        40.0,
        False,
        None,
        _DIAMETER,
        _GUIDED,
    ),
    Tool("ultrasound-1.7", "Radial ultrasound probe, 1.7 mm (UM-S20-20R)", 1.7, 40.0, False, None, "k"),
    # The source states 1.9 mm. The trade size of 1.95 mm (k) is used, because it is the safer one.
    Tool("guide-sheath", "Guide sheath, 1.95 mm (K-201)", 1.95, 40.0, False, None, "k", _GUIDED),
    Tool("guide-sheath-large", "Guide sheath, 2.55 mm (K-203)", 2.55, 40.0, False, None, "k"),
)


def tools() -> tuple[Tool, ...]:
    """Return all instruments of the library.

    Examples
    --------
    >>> [t.name for t in tools()][:2]
    ['needle-21g', 'needle-19g']
    """
    return _TOOLS


def passing_needle(scope: ScopePreset, wanted: Tool) -> Tool | None:
    """Return the first needle of the library that passes a scope's channel and reaches as far as another tool.

    The result is None if there is none or the channel is unknown.

    Examples
    --------
    >>> from carina.scopes import scope_preset
    >>> passing_needle(scope_preset("ultrathin"), tool("needle-21g")) is None
    True
    """
    if scope.channel_mm is None:
        return None
    return next(
        (one for one in _TOOLS if one.pierces and one.passes(scope.channel_mm) and one.reach_mm >= wanted.reach_mm),
        None,
    )


def tool(name: str) -> Tool:
    """Return the instrument of the library with this name.

    Raises
    ------
    UsageError
        If there is none; the message lists all names.
    """
    found = next((one for one in _TOOLS if one.name == name), None)
    if found is None:
        known = ", ".join(one.name for one in _TOOLS)
        raise UsageError(f"no tool is called {name!r}; expected one of {known}", code="plan.tool")
    return found


def tool_from_file(path: str | Path) -> Tool:
    """Read the user's own instrument from a JSON file in the format of `Tool.to_json`.

    Raises
    ------
    UsageError
        If the file cannot be read or contains impossible values. The message states the file, the field, the expected
        and the found value (code ``plan.own-file``).
    """
    return _tool(UserFile.read(path))


def tool_from_json(document: Any, *, where: str = "tool") -> Tool:
    """Return the user's own instrument from parsed JSON; error messages begin with ``where``.

    Raises
    ------
    UsageError
        If the document contains impossible values, as for `tool_from_file`.

    Examples
    --------
    >>> tool_from_json(tool("brush").to_json()) == tool("brush")
    True
    """
    return _tool(UserFile(where, document))


def _tool(file: UserFile) -> Tool:
    file.check(FORMAT, VERSION, [one.name for one in fields(Tool)])
    return Tool(
        file.text("name"),
        file.text("title"),
        file.size("outer_mm", _MAX["outer_mm"]),
        file.size("reach_mm", _MAX["reach_mm"]),
        file.flag("pierces", "true for a needle, else false"),
        file.number_or_none("rigid_mm", _MAX["rigid_mm"]),
        file.text("basis"),
        file.text_or_none("source"),
        file.number_or_none("flexion_loss_deg", _MAX["flexion_loss_deg"]),
    )
