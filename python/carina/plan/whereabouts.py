"""Where a target lies, in words: lung, pleura, airway, mediastinum or chest wall, outside the body."""

from __future__ import annotations

from typing import Literal

__all__ = ["WHERE_WORDS", "Whereabouts"]

Whereabouts = Literal["lung", "beside pleura", "mediastinum or chest wall", "in an airway", "outside the body"]

WHERE_WORDS: dict[Whereabouts, str] = {
    "lung": "in the lung",
    "beside pleura": "beside the pleura",
    "mediastinum or chest wall": "in the mediastinum or the chest wall",
    "in an airway": "in an airway",
    "outside the body": "outside the body",
}
