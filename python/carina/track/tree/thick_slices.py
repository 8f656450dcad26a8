"""Share of the length of airways that the search finds in slices of a given thickness, by calibre (calibrated)."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np

from carina.display import one_line
from carina.track.tree.airway_tree import AirwayTree
from carina.volume.model import Note, Volume

THICK_SLICES = "track.thick-slices"
"""Code of the permanent note on a search in slices that hide airways visible in thin slices."""

SLICES_MM = (0.7, 1.0, 1.5, 2.0, 2.5, 3.0, 5.0)
# By inner diameter in mm (from, to): least, mean and greatest share in % for each thickness of SLICES_MM, over five
# painted patients, three kernels and two phantoms (docs/decisions/0114; carina bench track --only shares).
SHARES: dict[tuple[float, float | None], tuple[tuple[int, int, int], ...]] = {
    (6.0, None): (*[(100, 100, 100)] * 6, (85, 95, 100)),
    (4.0, 6.0): ((95, 95, 100), (100, 100, 100), *[(95, 95, 100)] * 3, (85, 95, 100), (20, 55, 95)),
    (3.0, 4.0): (*[(95, 95, 100)] * 4, (80, 90, 100), (55, 85, 100), (5, 35, 70)),
    (2.0, 3.0): (
        *((90, 95, 100), (85, 95, 100), (75, 95, 100), (35, 80, 100)),
        *((45, 70, 90), (35, 60, 90), (0, 15, 45)),
    ),
    (1.0, 2.0): (
        *((35, 70, 100), (25, 55, 95), (10, 45, 85), (0, 15, 45)),
        *((0, 10, 45), (0, 10, 25), (0, 5, 20)),
    ),
}
JUDGED_MM = 2.0
"""Minimum inner diameter in mm of the airways (up to 3 mm) whose share decides whether slices are thick."""
THIN_SHARE = 0.95
"""Minimum mean share of airways of 2 to 3 mm that the search finds in thin slices; slices with less are thick."""
PATIENT_FACTOR = 1.25
"""Factor that converts the slice thickness of a patient's CT to that of painted CTs (of known anatomy).

Slices of patients hide as much as painted slices that are thicker by this factor (four CTs, lists of readers).
"""
STEP_PERCENT = 5
WIDEST_PIXEL_MM = 0.8
"""Maximum pixel width in mm for which the least and mean shares are known.

The calibrated CTs have pixels of 0.46 to 0.7 mm. In wider pixels fewer airways are found, so the greatest shares are
upper limits.
"""


@one_line
@dataclass(frozen=True, slots=True)
class CalibreShare:
    """Share of the length of airways of one calibre that the search finds in slices of one thickness."""

    from_mm: float
    """Smallest inner diameter of the airways, mm."""
    to_mm: float | None
    """Largest inner diameter of the airways, mm; None: no upper limit."""
    least: float
    """Smallest share in a single measured CT: 0 to 1, a multiple of 0.05 like :attr:`typical` and :attr:`most`.
    """
    typical: float | None
    """Mean share over the measured CTs; None if the pixels of the current CT are wider than theirs."""
    most: float
    """Largest share in a single measured CT."""

    def to_json(self) -> dict[str, float | None]:
        """Return the share as JSON values."""
        return {
            "from_mm": self.from_mm,
            "to_mm": self.to_mm,
            "least": self.least,
            "typical": self.typical,
            "most": self.most,
        }


@one_line
@dataclass(frozen=True, slots=True)
class CalibratedShares:
    """Shares of airways that the search finds in CTs with slices of one thickness."""

    slice_mm: float
    """Thickness of the slices in mm; their distance if the thickness is smaller or unknown."""
    distance_mm: float
    """Distance of the slices in mm; smaller than the thickness if the slices overlap."""
    shares: tuple[CalibreShare, ...]
    """Shares, one for each calibre, the widest first."""

    def to_json(self) -> dict[str, Any]:
        """Return the thickness and the shares as JSON values."""
        return {
            "slice_mm": self.slice_mm,
            "distance_mm": self.distance_mm,
            "shares": [share.to_json() for share in self.shares],
        }

    @property
    def slices(self) -> str:
        """Text of the slices, such as slices of 3 mm every 1.5 mm."""
        overlap = f" every {self.distance_mm:g} mm" if self.distance_mm < self.slice_mm else ""
        return f"slices of {self.slice_mm:g} mm{overlap}"


def effective_slice_mm(ct: Volume) -> float:
    """Return the effective thickness of the slices of a CT in mm (see :func:`effective_mm`)."""
    distance_mm = round(max(ct.spacing_mm), 2)
    return effective_mm(ct.source.slice_thickness_mm or 0.0, distance_mm)


def effective_mm(slice_mm: float, distance_mm: float) -> float:
    """Return the thickness in mm of slices without gap or overlap that show as many airways as the given slices."""
    return 0.5 * (max(slice_mm, distance_mm) + distance_mm)


def calibrated_shares(slice_mm: float) -> tuple[CalibreShare, ...]:
    """Return the shares of airways that the search finds in slices of a thickness, the widest calibre first.

    Between the calibrated thicknesses (0.7 to 5 mm) the shares are interpolated and rounded to 5 %, the greatest
    upwards and the others downwards. Beyond 5 mm only the greatest share is known.

    Examples
    --------
    >>> [share.most for share in calibrated_shares(0.8)][:4]
    [1.0, 1.0, 1.0, 1.0]
    """
    return tuple(_share_at(calibre, slice_mm) for calibre in SHARES)


def _share_at(calibre: tuple[float, float | None], slice_mm: float) -> CalibreShare:
    columns = zip(*SHARES[calibre], strict=True)
    low, mean, high = (float(np.interp(slice_mm, SLICES_MM, column)) / STEP_PERCENT for column in columns)
    # 1e-9: a floating-point sum just beside a whole step counts as that step.
    steps = np.array([np.floor(low + 1e-9), np.floor(mean + 1e-9), np.ceil(high - 1e-9)])
    least, typical, most = (round(float(step), 2) for step in steps * STEP_PERCENT / 100.0)
    is_known = slice_mm <= SLICES_MM[-1]
    return CalibreShare(*calibre, least if is_known else 0.0, typical if is_known else None, most)


def shares_in(ct: Volume) -> CalibratedShares | None:
    """Return the shares of a CT with thick slices; None if its slices are thin."""
    distance_mm = round(max(ct.spacing_mm), 2)
    slice_mm = max(ct.source.slice_thickness_mm or 0.0, distance_mm)
    effective = effective_slice_mm(ct)
    judged = _share_of_diameter(calibrated_shares(effective), JUDGED_MM).typical
    if judged is not None and judged >= THIN_SHARE:
        return None
    known_mm = SLICES_MM[-1]
    shares = calibrated_shares(effective if effective > known_mm else min(PATIENT_FACTOR * effective, known_mm))
    if round(sorted(ct.spacing_mm)[1], 2) > WIDEST_PIXEL_MM:
        shares = tuple(dataclasses.replace(share, least=0.0, typical=None) for share in shares)
    return CalibratedShares(slice_mm, distance_mm, shares)


def shares_of(tree: AirwayTree, ct: Volume) -> CalibratedShares | None:
    """Return the shares that the note :data:`THICK_SLICES` of a tree states; None for a tree without this note."""
    has_note = any(note.code == THICK_SLICES for note in tree.notes)
    return shares_in(ct) if has_note else None


def _share_of_diameter(shares: Sequence[CalibreShare], diameter_mm: float) -> CalibreShare:
    """Return the share of airways of a diameter that the search finds; below the smallest calibre, that calibre's."""
    return next((share for share in shares if diameter_mm >= share.from_mm), shares[-1])


def with_slice_note(tree: AirwayTree, ct: Volume) -> AirwayTree:
    """Return the tree of a CT with a permanent note that states the shares, if the slices are thick."""
    found = shares_in(ct)
    if found is None:
        return tree
    parts = list(_texts(found.shares))
    stated = f"{', '.join(parts[:-1])} and {parts[-1]}" if len(parts) > 1 else parts[0]
    words = (
        f"{found.slices}: in such CTs, Carina finds {stated}. An airway that is not in the tree may "
        "still be there. Open slices of 1 mm or less if small airways matter"
    )
    return dataclasses.replace(tree, notes=(*tree.notes, Note(THICK_SLICES, words, badge=True)))


def _percent(share: CalibreShare) -> str:
    """Return a share (0 to 1) as text in percent."""
    low, high = (f"{100.0 * part:.0f}" for part in (share.least, share.most))
    if low == high:
        return f"{high} %"
    spread = f"at most {high} %" if share.least == 0.0 else f"{low} to {high} %"
    return spread if share.typical is None else f"{100.0 * share.typical:.0f} % ({spread})"


def _texts(shares: Sequence[CalibreShare]) -> Iterator[str]:
    """Yield the text of each known share; neighbouring calibres with the same share are merged."""
    known = [share for share in shares if (share.least, share.most) != (0.0, 1.0)]
    for number, (_, group) in enumerate(groupby(known, lambda share: (share.least, share.typical, share.most))):
        same = list(group)
        from_mm, to_mm = same[-1].from_mm, same[0].to_mm
        of = "of the length of airways " if number == 0 else "of those "
        width = f"wider than {from_mm:g} mm" if to_mm is None else f"of {from_mm:g} to {to_mm:g} mm"
        yield f"{_percent(same[0])} {of}{width}"


def miss_text(found: CalibratedShares, diameter_mm: float | None) -> str:
    """Return the text that names thick slices as a reason for a missing airway.

    The text is empty if airways of this width are always found.

    Parameters
    ----------
    found
        The shares of the CT.
    diameter_mm
        Inner diameter of the airway that was lost; None if no airway was found.
    """
    share = None if diameter_mm is None else _share_of_diameter(found.shares, diameter_mm)
    if share is None or (share.least, share.most) == (0.0, 1.0):
        return f"; {found.slices} hide many airways, so it may still be there"
    if share.least == 1.0:
        return ""
    return f"; in {found.slices}, Carina finds {_percent(share)} of airways of this width"
