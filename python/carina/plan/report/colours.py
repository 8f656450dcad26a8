"""Colours of a report: black on white, one accent, one colour for the last leg, red for warnings."""

from __future__ import annotations

INK = "#14181c"
QUIET = "#5a646e"
PALE = "#dfe4e8"
ACCENT = "#0b5a8f"
"""Colour of the route along the airways."""
LEG = "#d35400"
"""Colour of the target and of the last leg."""
WARNING = "#c1001f"
"""Colour of drawn airways and of limits that forbid something; nothing else is red."""
TREE = "#b3bcc4"
"""Colour of airways that are not on the route."""
ON_CT = {"target": "#ffd23f", "leg": "#ff8c2b", "lumen": "#59bdff", "text": "#ffffff", "halo": "#000000"}
"""Brighter colours for drawings over a CT slice."""
