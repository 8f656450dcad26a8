"""Lobes and segments that are missing from a named tree, and the evidence of the CT in their place."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.track.names.anatomy_model import LOBES, grammar
from carina.track.names.name_texts import LEFT_ISOMERISM, MIRRORED_CHEST, bare_name, name_words
from carina.track.names.naming import segments_of_unnamed
from carina.track.names.scan_extent import ScanExtent
from carina.track.names.tree_fit import MISFIT
from carina.track.tree.airway_tree import AirwayTree, Branch
from carina.track.tree.thick_slices import CalibratedShares, miss_text, shares_of
from carina.track.tree.uncertainty import Uncertainty, slice_from_feet, slice_text
from carina.volume.model import Volume

AbsenceKind = Literal["outside", "resected", "blocked", "filled", "leak", "lost", "unnamed", "fine", "nothing"]

# Airways from which a lobe, or its segments, may arise, the nearest first; names of an unmirrored chest.
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
# In a right main bronchus longer than LONG_MAIN_MM, the bronchus of the upper lobe is expected at UPPER_LOBE_MM from
# its start.
UPPER_LOBE_MM = 20.0
LONG_MAIN_MM = 30.0
# An unnamed branch that begins farther than this beyond the end of a carrier belongs to another segment.
FARTHEST_MM = 15.0
USUAL_ORIGIN = 1.3
"""Usual distance of a bronchus from the carina, as a multiple of its shortest distance (:mod:`scan_extent`)."""
MIN_MATCH = 0.5
"""Minimum cosine between the direction beyond a filled place and the usual direction of a missing bronchus."""
# Maximum distance in mm between the filling of a bronchus and the end of the airway before it.
AT_END_MM = 4.0
# A tip up to this length may be the stump of a lobe's bronchus.
STUMP_MM = 10.0
_SWAP = {ord("R"): "L", ord("L"): "R"}
MAY_BE_HIDDEN = ("lost", "fine", "nothing")
"""Kinds of absences that thick slices alone may explain."""


@one_line
@dataclass(frozen=True, slots=True)
class Absence:
    """Lobe or segment of which no named bronchus was found, with the reason."""

    name: str
    """Name of the missing lobe or segment, such as RML or RB4."""
    kind: AbsenceKind
    """Reason why the lobe or segment is missing, from the evidence of the CT.

    ``outside``: its bronchus begins outside the scan. ``resected``: its bronchus is a stump. ``blocked`` and
    ``filled``: soft tissue is in the bronchus that leads there. ``lost`` and ``leak``: the search lost the airway
    that leads there; the CT proves no disease. ``unnamed``: a branch without a name is in its place. ``fine``: it
    may be thinner than the CT shows. ``nothing``: no branch was found in its place. See :class:`Uncertainty` for the
    evidence.
    """
    carrier: str
    """Name of the nearest airway that was found and would lead to the missing lobe or segment."""
    beyond_mm: float | None
    """Distance in mm along the airway from the start of ``carrier`` to ``lps``; None if no point is known."""
    lps: tuple[float, float, float] | None
    """Point where the airway ends, or where the missing bronchus should arise, LPS in mm; None if not known."""
    width_mm: float | None
    """Diameter in mm of the airway that ends at ``lps``; None if no airway ends there."""
    branch_id: int | None
    """ID of the unnamed branch that may be the missing bronchus, or of the branch that leads to it; None if unknown."""
    slice_number: int | None = None
    """Slice of ``lps``, counted from the feet, from 1."""
    num_slices: int | None = None
    """Number of slices of the scan."""
    has_clips: bool = False
    """Whether surgical clips are at the stump of the missing bronchus."""
    hidden_by: CalibratedShares | None = None
    """Thick slices that may hide the bronchus; None if the slices are thin or do not explain the absence."""

    @property
    def reason(self) -> str:
        """Text on what the CT shows in place of the missing bronchus, for all displays, reports and exports."""
        hidden = "" if self.hidden_by is None else miss_text(self.hidden_by, self.width_mm)
        return self._shown + hidden

    @property
    def _shown(self) -> str:
        """Text on what the CT shows in place of the missing bronchus, without the effect of thick slices."""
        at = slice_text(self.slice_number, self.num_slices)
        where = f"{self.beyond_mm or 0.0:.0f} mm beyond the start of {self.carrier}"
        width = f"{self.width_mm or 0.0:.1f} mm wide{at}"
        branch = "" if self.branch_id is None else f" in the unnamed branch {self.branch_id},"
        match self.kind:
            case "outside":
                return "outside this scan"
            case "resected":
                if self.has_clips:
                    return f"its bronchus ends in a stump with surgical clips {where}, {width}: it was resected"
                return (
                    f"its bronchus ends in a stump {where}, {width}, that is closed on all sides: it was resected, or "
                    "a tumour or mucus fills it"
                )
            case "blocked":
                return (
                    f"soft tissue fills the bronchus{branch} {where}, {width}: possibly mucus, a tumour or a collapsed "
                    "airway"
                )
            case "filled":
                return (
                    f"a bronchus beyond the start of {self.carrier} is narrowed or filled{at}: possibly secretions or "
                    "a mucus plug, a tumour or a collapsed airway"
                )
            case "leak":
                return (
                    f"lost{branch} {where}, {width}: the wall is too thin there, and the search would have leaked into "
                    "the lung"
                )
            case "lost":
                return f"lost{branch} {where}, {width}"
            case "unnamed":
                return f"an unnamed branch runs where it is expected: branch {self.branch_id}, which begins {where}{at}"
            case "fine":
                return f"beyond {self.carrier}{at}, airways are narrower than this CT shows reliably"
            case "nothing":
                return f"no branch leads there from {self.carrier}{at}"

    @property
    def full_name(self) -> str:
        """Short and long name of the missing lobe or segment, such as RB4 (lateral segment, RML)."""
        known = name_words(self.name)
        return self.name if known is None else known.full

    @property
    def words(self) -> str:
        """Sentence with the full name of the missing lobe or segment and the reason."""
        match self.kind:
            case "outside":
                return f"{self.full_name} is {self.reason}"
            case "unnamed":
                return f"{self.full_name} was not identified: {self.reason}"
            case _:
                return f"{self.full_name} was not found: {self.reason}"


def find_absent(
    tree: AirwayTree, uncertain: Sequence[Uncertainty] = (), volume: Volume | None = None
) -> tuple[Absence, ...]:
    """List the lobes and segments that are missing from a tree, with the findings of the CT in their place.

    A disease is named only where the CT proves it; see :class:`Absence`. A lobe of which nothing was found is listed
    once, without its segments. In a mirrored chest the three-lobed lung is the left one.

    Parameters
    ----------
    tree
        Tree with names. The list is empty if neither main bronchus has a name, or if the tree does not look like a
        human one.
    uncertain
        Ends of its airways, with their evidence: :attr:`carina.track.Airways.uncertain`.
    volume
        The CT: it shows which bronchi are outside the scan, and the slice of each place.

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
    found = _NamedTree(tree, names, uncertain, volume, is_mirrored=is_mirrored)
    missing = []
    lobes = [(lobe, keys, is_mirrored) for lobe, keys in LOBES.items()]
    if (tree.root.variant or "").startswith(LEFT_ISOMERISM):
        lobes = [(lobe, LOBES[lobe], swaps) for swaps in (True, False) for lobe in ("LUL", "LLL")]
    for lobe, keys, swaps in lobes:
        there = _on_side(lobe, swaps)
        carriers = [_on_side(name, swaps) for name in _LOBE_CARRIERS[lobe]]
        if there not in found.lobes:
            segments = frozenset(_on_side(key, swaps) for key in _segments(keys))
            missing.append(_Missing(there, lobe, (there, *carriers), segments))
            continue
        for key in _segments(keys):
            segment = _on_side(key, swaps)
            if not found.has(segment):
                trunk = [_on_side(_TRUNKS[key], swaps)] if key in _TRUNKS else []
                stems = found.stems_of(segment)
                missing.append(_Missing(segment, key, (*stems, *trunk, there, *carriers), frozenset({segment})))
    absences = tuple(found.absence(one, missing) for one in missing)
    slices = None if volume is None else shares_of(tree, volume)
    return tuple(
        dataclasses.replace(absence, hidden_by=slices) if absence.kind in MAY_BE_HIDDEN else absence
        for absence in absences
    )


@dataclass(frozen=True, slots=True)
class _Missing:
    """Lobe or segment that is missing from a tree."""

    name: str
    usual: str
    """Name of the missing lobe or segment in a chest that is not mirrored."""
    carriers: tuple[str, ...]
    """Names of the airways from which the missing bronchus may arise, the nearest first."""
    segments: frozenset[str]
    """Names of the segments that the missing lobe or segment comprises."""


def _on_side(name: str, is_mirrored: bool) -> str:
    if not is_mirrored:
        return name
    if name in ("Right basal trunk", "Left basal trunk"):
        return "Left basal trunk" if name.startswith("Right") else "Right basal trunk"
    swaps = name[:2] in ("RB", "LB") or name in _LOBE_CARRIERS or name in ("RMB", "LMB")
    return name[0].translate(_SWAP) + name[1:] if swaps else name


def _segments(keys: Sequence[str]) -> Iterator[str]:
    for key in keys:
        # Subsuperior segments are left out: only one patient in six has one. LB1 and LB2 count together as LB1+2.
        if key.endswith("*") or key == "LB2":
            continue
        yield "LB1+2" if key == "LB1" else key


class _NamedTree:
    """Named branches of a tree, and the evidence at their ends."""

    def __init__(
        self,
        tree: AirwayTree,
        names: Sequence[str | None],
        uncertain: Sequence[Uncertainty],
        volume: Volume | None,
        *,
        is_mirrored: bool,
    ) -> None:
        self._tree = tree
        self._volume = volume
        self._is_mirrored = is_mirrored
        self._extent = None if volume is None else ScanExtent(volume, tree, names)
        self._branches = {branch.id: branch for branch in tree.branches}
        self._names = {branch.id: name for branch, name in zip(tree.branches, names, strict=True)}
        self._filled = [place for place in uncertain if place.kind == "filled"]
        self._ends = {
            place.branch_id: place
            for place in uncertain
            if place.kind in ("volume", "blocked", "stump", "leak", "lost")
            and place.branch_id is not None
            # A stump on the side of a branch is not where the branch ends.
            and not (place.kind == "stump" and _is_beside(place, self._branches.get(place.branch_id)))
        }
        self._is_fine = any(place.kind == "fine" for place in uncertain)
        self._unnamed: dict[int, frozenset[str]] | None = None
        # Names without the letters of subsegments. LB1+2 of a mirrored chest is named RB1+2, like a common stem.
        self._segments = {name.rstrip(_LETTERS) for name in names if name is not None}
        known = [name_words(name) for name in names if name is not None]
        self.lobes = {one.lobe for one in known if one is not None and one.lobe is not None} - self._stumps()

    def _stumps(self) -> set[str]:
        """Return the lobes of which only the short blind beginning of the bronchus was found."""
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
        # The first millimetres of a branch are inside the lumen of its parent.
        inside_mm = 0.0 if branch.parent is None else float(self._branches[branch.parent].radius[-1])
        return not branch.children and branch.length_mm - inside_mm <= STUMP_MM

    def has(self, segment: str) -> bool:
        """Return whether a segment is in the tree; LB1+2 is also in the tree if both of its halves are."""
        if segment in self._segments:
            return True
        halves = {f"{segment[:2]}1", f"{segment[:2]}2"}
        return segment.endswith("B1+2") and halves <= self._segments

    def stems_of(self, segment: str) -> list[str]:
        """Return the names of the stems (bronchi of several segments) of a segment, the smallest stem first."""
        side, number = segment[:2], segment[2:]
        stems = {name for name in self._names.values() if name is not None and name.startswith(side) and "+" in name}
        holding = [stem for stem in stems if set(number.split("+")) <= set(stem[2:].rstrip(_LETTERS).split("+"))]
        return sorted((stem for stem in holding if stem != segment), key=lambda stem: (stem.count("+"), stem))

    def absence(self, one: _Missing, missing: Sequence[_Missing]) -> Absence:
        """Return the absence of a bronchus with the evidence of the CT, given all missing bronchi."""
        name, usual, carriers, segments = one.name, one.usual, one.carriers, one.segments
        carrier = next((known for known in carriers if known in self._names.values()), "the trachea")
        start = next((branch for branch in self._branches.values() if self._names[branch.id] == carrier), None)
        if start is None:
            start = next(iter(self._branches.values()))
        chain = self._chain(start)
        if self._is_outside(usual, name[0]):
            return Absence(name, "outside", carrier, None, None, None, None)
        make = _Maker(self, name, carrier, start)
        inside = {branch.id for branch in chain}
        below = [branch for branch in self._subtree(start) if branch.id not in inside]
        holder = self._holder(segments, chain, below)
        last = chain[-1] if holder is None else holder
        end = self._ends.get(last.id)
        branch_id = None if holder is None else holder.id
        filled = self._filled_for(one, missing, chain, last)
        if filled is not None:
            return make.at_place(filled)
        if holder is None and len(segments) > 1 and (stump := self._stump_on(chain, name)) is not None:
            return make.at_place(stump, kind="resected")
        if end is not None and _kind(end) == "blocked":
            return make.at_place(end, branch_id=branch_id)
        if holder is not None and (holder.children or self._reading(holder.id) <= segments):
            return make.at("unnamed", holder.points[0], holder, branch_id=holder.id)
        if end is not None:
            return make.at_place(end, branch_id=branch_id)
        if self._leaves_scan(below) and self._is_outside(usual, name[0], scale=USUAL_ORIGIN):
            return make.at("outside", last.tip_lps, last)
        if holder is None and (other := self._other_unnamed(chain)) is not None:
            return make.at("unnamed", other.points[0], other, branch_id=other.id)
        if self._is_fine and not last.children:
            return make.at("fine", last.tip_lps, last, branch_id=branch_id)
        return make.at("nothing", self._origin(name, carrier, chain), chain[-1])

    def _is_outside(self, usual: str, side: str, *, scale: float = 1.0) -> bool:
        return self._extent is not None and self._extent.is_outside(usual, side=side, scale=scale)

    def _leaves_scan(self, below: Sequence[Branch]) -> bool:
        """Return whether an airway beyond a carrier leaves the scan."""
        return any(branch.id in self._ends and self._ends[branch.id].kind == "volume" for branch in below)

    def _filled_for(
        self, one: _Missing, missing: Sequence[_Missing], chain: Sequence[Branch], last: Branch
    ) -> Uncertainty | None:
        """Return the place with filled lumen that explains why a bronchus is missing, or None.

        A place explains it if the airway that leads to the missing bronchus ends at the place. A place with unreached
        air beyond also explains it, if this air lies in the direction of the bronchus and not of another missing one.
        """
        if not last.children:
            near = [
                place
                for place in self._filled
                if _is_at_end(place, last) or (place.branch_id == last.id and place.beyond_lps is not None)
            ]
            if near:
                return max(near, key=lambda place: place.calibre_mm or place.width_mm)
        ids = {last.id, *(branch.id for branch in chain)}
        ids |= {child for branch in chain for child in branch.children if self._names[child] is None}
        rivals = [other for other in missing if other.name[0] == one.name[0]]
        for place in self._filled:
            if place.branch_id in ids and place.beyond_lps is not None:
                match = self._match(one, place)
                if match >= MIN_MATCH and match >= max(self._match(other, place) for other in rivals):
                    return place
        return None

    def _match(self, one: _Missing, place: Uncertainty) -> float:
        """Return the cosine between the direction beyond a filled place and the usual direction of a bronchus."""
        direction = np.array(place.beyond_lps) - np.array(place.lps)
        return float(self._expected(one.usual) @ direction) / max(float(np.linalg.norm(direction)), 1e-9)

    def _expected(self, usual: str) -> NDArray[np.float64]:
        """Return the usual unit direction of a bronchus, LPS."""
        rules = grammar()
        state = rules.names.index("LB1" if usual == "LB1+2" else usual)
        direction: NDArray[np.float64] = rules.direction[state] * (-1.0 if self._is_mirrored else 1.0, 1.0, 1.0)
        return direction

    def _other_unnamed(self, chain: Sequence[Branch]) -> Branch | None:
        """Return the largest branch at an airway's end that has neither a name nor a probable segment, or None."""
        found = [
            self._branches[child]
            for branch in chain
            for child in branch.children
            if self._names[child] is None and not self._reading(child)
        ]
        found = [branch for branch in found if branch.children or branch.length_mm > STUMP_MM]
        return max(found, key=lambda branch: float(np.median(branch.radius))) if found else None

    def _reading(self, branch_id: int) -> frozenset[str]:
        """Return the segments to which an unnamed branch probably leads."""
        if self._unnamed is None:
            has_unnamed = any(name is None for name in self._names.values())
            self._unnamed = segments_of_unnamed(self._tree) if has_unnamed else {}
        return self._unnamed.get(branch_id, frozenset())

    def _holder(self, segments: frozenset[str], chain: Sequence[Branch], below: Sequence[Branch]) -> Branch | None:
        """Return an unnamed branch near an airway's end that leads to the given segments; None if there is none."""
        near = [
            branch
            for branch in below
            if self._names[branch.id] is None
            and self.along_mm(chain[-1], branch, branch.points[0]) - chain[-1].length_mm <= FARTHEST_MM
        ]
        if len(segments) == 1:
            held = [branch for branch in near if segments <= self._reading(branch.id)]
            return held[-1] if held else None
        whole = [branch for branch in near if (keys := self._reading(branch.id)) and keys <= segments]
        return whole[0] if whole else None

    def _stump_on(self, chain: Sequence[Branch], lobe: str) -> Uncertainty | None:
        """Return the place on an airway at which a lobe's bronchus ends in a stump, or None.

        A stump is a short branch that has the lobe's name or no name.
        """
        near = [*chain, *(self._branches[child] for branch in chain for child in branch.children)]
        for branch in near:
            place = self._ends.get(branch.id)
            is_own = self._names[branch.id] in (None, lobe)
            if place is not None and place.kind == "stump" and is_own and self._is_stump(branch):
                return place
        return None

    def _chain(self, start: Branch) -> list[Branch]:
        """Return the successive branches of one airway, between side branches, that share the name of a branch."""
        chain = [start]
        while True:
            name = self._names[start.id]
            going_on = [child for child in chain[-1].children if name is not None and self._names[child] == name]
            if not going_on:
                return chain
            chain.append(self._branches[going_on[0]])

    def _subtree(self, start: Branch) -> Iterator[Branch]:
        waiting = [start.id]
        while waiting:
            branch = self._branches[waiting.pop(0)]
            yield branch
            waiting += branch.children

    def _origin(self, name: str, carrier: str, chain: Sequence[Branch]) -> NDArray[np.float64]:
        """Return the point on its parent at which a bronchus should begin, LPS in mm."""
        points = np.concatenate([branch.points for branch in chain])
        at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        # Without a fork, the right main bronchus and the bronchus intermedius are one branch.
        if name == "RUL" and carrier == "RMB" and "BI" not in self._names.values() and at[-1] > LONG_MAIN_MM:
            return np.array([np.interp(UPPER_LOBE_MM, at, points[:, axis]) for axis in range(3)])
        return np.asarray(points[-1])

    def along_mm(self, start: Branch, branch: Branch, point: NDArray[np.float64]) -> float:
        """Return the distance (mm) of a point of a branch from the start of another branch, along the airways."""
        index = int(np.argmin(np.linalg.norm(branch.points - point, axis=1)))
        length_mm = float(np.linalg.norm(np.diff(branch.points[: index + 1], axis=0), axis=1).sum())
        at = branch
        while at.id != start.id and at.parent is not None:
            at = self._branches[at.parent]
            length_mm += at.length_mm
        return length_mm

    def branch(self, branch_id: int) -> Branch:
        """Return the branch with the given ID."""
        return self._branches[branch_id]

    def slice_of(self, point: NDArray[np.float64]) -> tuple[int, int] | tuple[None, None]:
        """Return the slice of a point and the number of slices; (None, None) without a CT."""
        return (None, None) if self._volume is None else slice_from_feet(self._volume, point)


@dataclass(frozen=True, slots=True)
class _Maker:
    """Factory of the absences of one lobe or segment."""

    found: _NamedTree
    name: str
    carrier: str
    start: Branch

    def at(
        self, kind: AbsenceKind, point: NDArray[np.float64], branch: Branch, *, branch_id: int | None = None
    ) -> Absence:
        """Return an absence at a point of a branch."""
        number, count = self.found.slice_of(point)
        lps = (float(point[0]), float(point[1]), float(point[2]))
        beyond_mm = self.found.along_mm(self.start, branch, point)
        return Absence(self.name, kind, self.carrier, beyond_mm, lps, None, branch_id, number, count)

    def at_place(self, place: Uncertainty, *, kind: AbsenceKind | None = None, branch_id: int | None = None) -> Absence:
        """Return an absence at a place where an airway ends or is filled."""
        assert place.branch_id is not None
        branch = self.found.branch(place.branch_id)
        point = np.array(place.lps) if place.kind == "filled" else branch.tip_lps
        beyond_mm = self.found.along_mm(self.start, branch, point)
        return Absence(
            self.name,
            kind or _kind(place),
            self.carrier,
            beyond_mm,
            place.lps,
            place.width_mm,
            branch_id,
            place.slice_number,
            place.num_slices,
            place.has_clips,
        )


def _is_at_end(place: Uncertainty, branch: Branch) -> bool:
    """Return whether a branch ends at a place with filled lumen."""
    off_mm = float(np.linalg.norm(branch.tip_lps - np.array(place.lps)))
    return off_mm <= 0.5 * (place.length_mm or 0.0) + AT_END_MM


def _is_beside(place: Uncertainty, branch: Branch | None) -> bool:
    """Return whether a place with filled or closed lumen is far from the tip of its branch."""
    return branch is not None and float(np.linalg.norm(branch.tip_lps - np.array(place.lps))) > AT_END_MM


def _kind(place: Uncertainty) -> AbsenceKind:
    match place.kind:
        case "volume":
            return "outside"
        case "blocked" if place.length_mm is not None:
            return "blocked"
        case "filled" | "leak":
            return place.kind
        case _:
            return "lost"
