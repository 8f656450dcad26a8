"""Movement of a target: the largest distance from its position in the CT, and the origin of this number."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, get_args

from carina.argument_checks import check_fields, choice, each, lps_point, number_from, text_of
from carina.display import one_line
from carina.errors import UsageError

MovementOrigin = Literal["default", "given", "measured"]

LOWER_LOBE_MM, ELSEWHERE_MM = 20.0, 15.0
"""Maximum distance in mm of a nodule from its place in a CT at full inspiration, in the lower lobes and elsewhere.

The movement is 17.6 mm on average and more than 20 mm in the lower lobes (85 lesions; source: Chen et al., Chest
2015;147:1275). The value of 15 mm elsewhere is common knowledge.
"""
MAX_MOVED_MM = 60.0
"""Maximum accepted error of a stated movement, mm; the movement itself may be twice as large."""
NAMED_SHARE = 0.25
"""Minimum component of a shift, as a share of the shift's length, at which the text names its direction."""
DIRECTIONS = (
    ("towards the patient's left", "towards the patient's right"),
    ("to the back", "to the front"),
    ("up", "down"),
)


@one_line
@dataclass(frozen=True, slots=True)
class TargetMovement:
    """Possible movement of a target since the CT, with the origin of the number."""

    origin: MovementOrigin
    """*default*: by the lobe. *given*: stated by the user. *measured*: from a second CT."""
    most_mm: float
    """Largest distance of the target from its place in the CT, mm; for a measured movement shift and error."""
    shift_lps: tuple[float, float, float] | None = None
    """Measured shift from this CT to the second CT relative to the main carina, LPS mm; None unless measured."""
    error_mm: float | None = None
    """Radius in mm round the measured shift that contains the true shift in 90 % of cases; None unless measured."""
    notes: tuple[str, ...] = ()
    """Warnings about the movement, for the user."""

    def __post_init__(self) -> None:
        """Raise an error if a field of this `TargetMovement` has an invalid value."""
        check_fields(
            self,
            origin=choice(*get_args(MovementOrigin)),
            most_mm=number_from(0.0, 2.0 * MAX_MOVED_MM, unit="mm"),
            shift_lps=lps_point(optional=True),
            error_mm=number_from(0.0, MAX_MOVED_MM, optional=True, unit="mm"),
            notes=each(text_of(20_000)),
        )
        is_measured = self.shift_lps is not None and self.error_mm is not None
        if (self.origin == "measured") != is_measured or (self.shift_lps is None) != (self.error_mm is None):
            raise UsageError(
                "movement: expected a shift with its error for a measured movement alone; use measured_movement",
                code="movement.value",
            )

    @property
    def length_mm(self) -> float | None:
        """Length of the measured shift, mm; None unless measured."""
        return None if self.shift_lps is None else math.hypot(*self.shift_lps)

    @property
    def words(self) -> str:
        """Movement as a sentence for reports and windows, without a full stop."""
        if self.shift_lps is None or self.error_mm is None:
            given = " (entered by the user)" if self.origin == "given" else ""
            return (
                "CT taken at inspiration: in the procedure the target may lie up to "
                f"{self.most_mm:.0f} mm from where it is shown here{given}"
            )
        return (
            f"Movement of the target measured from the second CT: {shift_words(self.shift_lps)}, "
            f"\u00b1 {math.ceil(self.error_mm)} mm relative to the main carina"
        )

    @property
    def region_words(self) -> str:
        """Region that may contain the target as text, such as *anywhere within 15 mm*."""
        if self.error_mm is None:
            return f"anywhere within {self.most_mm:.0f} mm"
        return f"anywhere between its places in both CTs, \u00b1 {math.ceil(self.error_mm)} mm"

    def to_json(self) -> dict[str, Any]:
        """Return the movement as plain JSON types."""
        return {
            "origin": self.origin,
            "most_mm": self.most_mm,
            "shift_lps": None if self.shift_lps is None else list(self.shift_lps),
            "error_mm": self.error_mm,
            "words": self.words,
            "notes": list(self.notes),
        }

    @classmethod
    def measured(
        cls, shift_lps: tuple[float, float, float], error_mm: float, notes: tuple[str, ...] = ()
    ) -> TargetMovement:
        """Return a measured movement whose largest distance is the sum of the shift's length and its error."""
        return cls("measured", math.hypot(*shift_lps) + error_mm, shift_lps, error_mm, notes)


def default_movement(lobe: str | None) -> TargetMovement:
    """Return the movement of a target in a lobe (RUL, RML, RLL, LUL or LLL) at full inspiration.

    The larger value also applies if the lobe is unknown.
    """
    return TargetMovement("default", LOWER_LOBE_MM if lobe in {"RLL", "LLL", None} else ELSEWHERE_MM)


def shift_words(shift_lps: tuple[float, float, float]) -> str:
    """Return length and main directions of a shift, such as *9 mm down* or *11 mm (9 mm down, 6 mm to the front)*."""
    length = math.hypot(*shift_lps)
    if length < 1.0:
        return "less than 1 mm"
    parts = sorted(zip(shift_lps, DIRECTIONS, strict=True), key=lambda part: -abs(part[0]))
    named = [(value, both) for value, both in parts if abs(value) >= max(NAMED_SHARE * length, 0.5)]
    texts = [f"{abs(value):.0f} mm {both[0 if value > 0.0 else 1]}" for value, both in named]
    return texts[0] if len(texts) == 1 else f"{length:.0f} mm ({', '.join(texts)})"
