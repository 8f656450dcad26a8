"""Absence is a finding: lobes and segments that a named tree lacks, and why."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from carina.display import one_line
from carina.track.names.goodness import MISFIT
from carina.track.names.model import LOBES
from carina.track.names.words import MIRRORED_CHEST, bare_name, name_words
from carina.track.tree.airway_tree import AirwayTree, Branch
from carina.track.tree.uncertain import Uncertainty

__all__ = ["Absence", "AbsenceKind", "find_absent"]

AbsenceKind = Literal["volume", "blocked", "filled", "leak", "unnamed", "fine", "nothing"]

# What carries a lobe, or segments of one, the nearest first; names of the usual side.
_LOBE_CARRIERS = {
    "RUL": ("RMB", "Trachea"),
    "RML": ("BI", "RMB", "Trachea"),
    "RLL": ("BI", "RMB", "Trachea"),
    "LUL": ("LMB", "Trachea"),
    "LLL": ("LMB", "Trachea"),
}
_TRUNKS = {
    "LB1+2": "Upper division",
    "LB3": "Upper division",
    "LB4": "Lingula",
    "LB5": "Lingula",
    **dict.fromkeys(("RB7", "RB8", "RB9", "RB10"), "Right basal trunk"),
    **dict.fromkeys(("LB8", "LB9", "LB10"), "Left basal trunk"),
}
_LETTERS = "abcdeiv"
# An airway that ends this far beyond its carrier's end is an ordinary tip, not what is missing.
FARTHEST_MM = 25.0
# A tip that is no longer than this may be the stump of a lobe's bronchus.
STUMP_MM = 10.0
_SWAP = {ord("R"): "L", ord("L"): "R"}


@one_line
@dataclass(frozen=True, slots=True)
class Absence:
    """A lobe or a segment of which no bronchus was found."""

    name: str
    """RML, RB4, ..."""
    kind: AbsenceKind
    """``volume`` (the scan ends before it), ``blocked``, ``filled`` and ``leak`` (the airway that leads there was lost
    on the way, see :class:`Uncertainty`), ``unnamed`` (it may be among branches without a name), ``fine`` (thinner than
    the CT shows), ``nothing`` (nothing leaves for it)."""
    carrier: str
    """The nearest airway found that would lead there."""
    beyond_mm: float | None
    """How far beyond the beginning of ``carrier`` the airway ends, along it; None where none ends there."""
    lps: tuple[float, float, float] | None
    """Where it ends."""
    width_mm: float | None
    """How wide it is there."""
    num_unnamed: int
    """Branches without a name beyond ``carrier``."""

    @property
    def reason(self) -> str:
        """Why, in words."""
        match self.kind:
            case "volume":
                return f"the scan ends {self.beyond_mm:.0f} mm beyond the start of {self.carrier}"
            case "blocked":
                return (
                    f"the lumen ends {self.beyond_mm:.0f} mm beyond the start of {self.carrier}, where it is "
                    f"{self.width_mm:.1f} mm wide: possibly mucus, a collapsed, narrowed or resected airway, or a wall "
                    "that the CT does not show"
                )
            case "filled":
                return (
                    f"a bronchus beyond the start of {self.carrier} is narrowed or filled: possibly secretions or a "
                    "mucus plug, a tumour or a collapsed airway"
                )
            case "leak":
                return (
                    f"the airway was lost {self.beyond_mm:.0f} mm beyond the start of {self.carrier}, where it is "
                    f"{self.width_mm:.1f} mm wide and its wall too thin"
                )
            case "unnamed":
                branches = "the unnamed branch" if self.num_unnamed == 1 else f"the {self.num_unnamed} unnamed branches"
                return f"it may be among {branches} beyond {self.carrier}"
            case "fine":
                return f"beyond {self.carrier}, airways are narrower than this CT shows reliably"
            case "nothing":
                return (
                    f"no airway for it leaves {self.carrier}: it may be absent, resected, obstructed at its origin, or "
                    "not visible in this CT"
                )

    @property
    def full_name(self) -> str:
        """RB4 (lateral segment, RML)"""
        known = name_words(self.name)
        return self.name if known is None else known.full

    @property
    def words(self) -> str:
        """RB4 (lateral segment, RML) was not found: ..."""
        return f"{self.full_name} was not found: {self.reason}"


def find_absent(tree: AirwayTree, uncertain: Sequence[Uncertainty] = ()) -> tuple[Absence, ...]:
    """Which lobes and segments a tree lacks, and why each does.

    A lobe of which nothing was found is listed once, without its segments. In a mirrored chest the three-lobed lung is
    the left one.

    Parameters
    ----------
    tree
        With names. Where neither main bronchus has one, or the tree does not look like a human one, there is too little
        to tell what is missing.
    uncertain
        Where its airways end, and why: :attr:`carina.track.Airways.uncertain`.

    Returns
    -------
    tuple of Absence
        Lobe by lobe, the right lung first.

    Examples
    --------
    >>> import numpy as np
    >>> trunk = Branch(0, None, (1, 2), 0, "Trachea", "tracked", np.array([[0.0, 0, 0], [0, 0, -90]]), np.full(2, 8.0))
    >>> right = Branch(1, 0, (), 1, "RMB", "tracked", np.array([[0.0, 0, -90], [-20, 0, -100]]), np.full(2, 6.0))
    >>> left = Branch(2, 0, (), 1, "LMB", "tracked", np.array([[0.0, 0, -90], [40, 0, -110]]), np.full(2, 6.0))
    >>> [absence.name for absence in find_absent(AirwayTree((trunk, right, left)))]
    ['RUL', 'RML', 'RLL', 'LUL', 'LLL']
    """
    names = [None if branch.name is None else bare_name(branch.name) for branch in tree.branches]
    if not {"RMB", "LMB"} & set(names) or any(note.code == MISFIT for note in tree.notes):
        return ()
    is_mirrored = "LML" in names or (tree.root.variant or "").startswith(MIRRORED_CHEST)
    found = _Found(tree, names, uncertain)
    absent = []
    for lobe, keys in LOBES.items():
        there = _on_side(lobe, is_mirrored)
        if there not in found.lobes:
            carriers = [_on_side(name, is_mirrored) for name in _LOBE_CARRIERS[lobe]]
            absent.append(found.absence(there, [there, *carriers]))
            continue
        for key in _segments(keys):
            segment = _on_side(key, is_mirrored)
            if not found.has(segment):
                trunk = [_on_side(_TRUNKS[key], is_mirrored)] if key in _TRUNKS else []
                more = [_on_side(name, is_mirrored) for name in _LOBE_CARRIERS[lobe]]
                absent.append(found.absence(segment, [*found.stems_of(segment), *trunk, there, *more]))
    return tuple(absent)


def _on_side(name: str, is_mirrored: bool) -> str:
    if not is_mirrored:
        return name
    if name in ("Right basal trunk", "Left basal trunk"):
        return "Left basal trunk" if name.startswith("Right") else "Right basal trunk"
    return name[0].translate(_SWAP) + name[1:] if name[:2] in ("RB", "LB") or name in _LOBE_CARRIERS else name


def _segments(keys: Sequence[str]) -> Iterator[str]:
    for key in keys:
        # One patient in six has a subsuperior bronchus; LB1 and LB2 are the halves of LB1+2.
        if key.endswith("*") or key == "LB2":
            continue
        yield "LB1+2" if key == "LB1" else key


class _Found:
    """What a tree has, and where it ends."""

    def __init__(self, tree: AirwayTree, names: Sequence[str | None], uncertain: Sequence[Uncertainty]) -> None:
        self._branches = {branch.id: branch for branch in tree.branches}
        self._names = {branch.id: name for branch, name in zip(tree.branches, names, strict=True)}
        self._ends = {
            place.branch_id: place for place in uncertain if place.kind in ("volume", "blocked", "filled", "leak")
        }
        self._is_fine = any(place.kind == "fine" for place in uncertain)
        # Without the letters of subsegments; LB1+2 of a mirrored chest is RB1+2, a stem by its name.
        self._segments = {name.rstrip(_LETTERS) for name in names if name is not None}
        known = [name_words(name) for name in names if name is not None]
        self.lobes = {one.lobe for one in known if one is not None and one.lobe is not None} - self._stumps()

    def _stumps(self) -> set[str]:
        """Lobes of which the short blind beginning of their bronchus is all that is there."""
        by_lobe: dict[str, list[Branch]] = {}
        for branch in self._branches.values():
            known = name_words(self._names[branch.id] or "")
            if known is not None and known.lobe is not None:
                by_lobe.setdefault(known.lobe, []).append(branch)
        return {
            lobe
            for lobe, branches in by_lobe.items()
            if all(self._names[branch.id] == lobe and self._is_stump(branch) for branch in branches)
        }

    def _is_stump(self, branch: Branch) -> bool:
        # Its first millimetres lie in the lumen of the airway that it leaves.
        inside_mm = 0.0 if branch.parent is None else float(self._branches[branch.parent].radius[-1])
        return not branch.children and branch.length_mm - inside_mm <= STUMP_MM

    def has(self, segment: str) -> bool:
        """LB1+2 is there where its two halves are."""
        if segment in self._segments:
            return True
        halves = {f"{segment[:2]}1", f"{segment[:2]}2"}
        return segment.endswith("B1+2") and halves <= self._segments

    def stems_of(self, segment: str) -> list[str]:
        """Names of common stems that hold a segment, those of the fewest first."""
        side, number = segment[:2], segment[2:]
        stems = {name for name in self._names.values() if name is not None and name.startswith(side) and "+" in name}
        holding = [stem for stem in stems if set(number.split("+")) <= set(stem[2:].rstrip(_LETTERS).split("+"))]
        return sorted((stem for stem in holding if stem != segment), key=lambda stem: (stem.count("+"), stem))

    def absence(self, name: str, carriers: Sequence[str]) -> Absence:
        """Why a bronchus is not there, from what lies beyond the nearest of its carriers."""
        carrier = next((one for one in carriers if one in self._names.values()), "the trachea")
        start = next((branch for branch in self._branches.values() if self._names[branch.id] == carrier), None)
        if start is None:
            start = next(iter(self._branches.values()))
        beyond = list(self._beyond(start))
        unnamed = [branch for branch in beyond if self._names[branch.id] is None]
        if name in _LOBE_CARRIERS or name == "LML":
            # What a resection leaves of a lobe's bronchus is no lobe.
            unnamed = [branch for branch in unnamed if branch.children or branch.length_mm > STUMP_MM]
        farthest_mm = self._along_mm(start, start.id) + FARTHEST_MM
        lost = [branch.id for branch in beyond if branch.id in self._ends]
        ends = [self._ends[one] for one in lost if self._along_mm(start, one) <= farthest_mm]
        if ends:
            end = max(ends, key=lambda place: place.calibre_mm or place.width_mm)
            assert end.branch_id is not None
            return Absence(
                name, _kind(end), carrier, self._along_mm(start, end.branch_id), end.lps, end.width_mm, len(unnamed)
            )
        tips = [branch for branch in beyond if not branch.children]
        kind: AbsenceKind = "unnamed" if unnamed else "fine" if self._is_fine and tips else "nothing"
        return Absence(name, kind, carrier, None, None, None, len(unnamed))

    def _beyond(self, start: Branch) -> Iterator[Branch]:
        """A carrier and what hangs on it without a name of its own: airways of other names lead elsewhere."""
        name = self._names[start.id]
        waiting = [start.id]
        while waiting:
            branch = self._branches[waiting.pop(0)]
            yield branch
            waiting += [child for child in branch.children if self._names[child] in (None, name)]

    def _along_mm(self, start: Branch, branch_id: int) -> float:
        length_mm = 0.0
        at: int | None = branch_id
        while at is not None:
            branch = self._branches[at]
            length_mm += branch.length_mm
            at = None if at == start.id else branch.parent
        return length_mm


def _kind(end: Uncertainty) -> AbsenceKind:
    match end.kind:
        case "volume" | "filled" | "leak":
            return end.kind
        case _:
            return "blocked"
