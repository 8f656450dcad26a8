"""Limits that the figures of the benchmarks must meet."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

__all__ = ["Gate"]


@dataclass(frozen=True, slots=True)
class Gate:
    """Figure of a benchmark with the limit that it must reach."""

    name: str
    figure: float
    limit: float
    better: Literal["higher", "lower"] = "higher"
    aim: bool = False
    """Whether a missed limit is only reported and does not make the benchmark fail."""
    note: str | None = None

    @property
    def passed(self) -> bool:
        """Whether the measured figure reaches the limit; False if the figure was not measured."""
        return self.figure >= self.limit if self.better == "higher" else self.figure <= self.limit

    def to_json(self) -> dict[str, Any]:
        """Return the gate as JSON values for the report."""
        return {
            "name": self.name,
            "figure": self.figure,
            "limit": self.limit,
            "better": self.better,
            "kind": "aim" if self.aim else "gate",
            "passed": self.passed,
            **({} if self.note is None else {"note": self.note}),
        }

    def line(self) -> str:
        """Return the figure, its limit and whether the limit is reached, as one line of text."""
        sign = ">=" if self.better == "higher" else "<="
        word = "passed" if self.passed else "MISSED"
        kind = "aim " if self.aim else "gate"
        note = "" if self.note is None else f"  ({self.note})"
        return f"  {kind} {word}  {self.name}: {self.figure:.4g} (limit {sign} {self.limit:g}){note}"
