"""Result of the airway search: the airways of a volume."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, replace
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from carina.argument_checks import (
    array_of,
    check_fields,
    each,
    instance,
    lps_point,
    lps_points,
    mask_array,
    number_from,
    text_of,
    whole_from,
)
from carina.commands.tree import AnyTreeEdit as TreeEdit
from carina.display import as_words
from carina.track.find.per_volume_cache import PerVolumeCache
from carina.track.names.absent import Absence, find_absent
from carina.track.paths.tracker import PathTracker
from carina.track.tree.airway_tree import AirwayTree
from carina.track.tree.thick_slices import CalibratedShares, shares_of
from carina.track.tree.uncertainty import Uncertainty
from carina.volume.model import Note
from carina.volume.sparse_mask import PackedMask

TREE_EDITS = get_args(TreeEdit)


def _check_threshold(where: str, name: str, value: object) -> None:
    """Raise an error unless a threshold is a finite number, or NaN (the threshold of a lumen from a file)."""
    if not (isinstance(value, float) and math.isnan(value)):
        number_from(-40_000.0, 40_000.0)(where, name, value)


@dataclass(frozen=True, slots=True, eq=False)
class Airways:
    """The airways of a volume.

    Instances can be copied and pickled, also for another process (multiprocessing, joblib, Ray). Tree, paths, edits and
    measurements of the copy are the same, bit for bit. A pickle contains the CT and a compressed lumen.

    Examples
    --------
    >>> import carina
    >>> phantom = carina.generate_phantom(spacing_mm=3.0, generations=3)
    >>> airways = carina.find_airways(phantom.volume)
    >>> airways.lumen_zyx.shape == phantom.volume.shape_zyx
    True
    """

    lumen_zyx: NDArray[np.uint8]
    """Lumen mask (nz, ny, nx) on the grid of the CT, 1 inside, read-only.

    A lumen found in the CT ends where a wall begins to show; :func:`carina.track.lumen_mask` extends it to the
    half-maximum, as exported files and volumes in ml do. Paths run in :attr:`PathTracker.lumen_zyx`, which is finer if
    the slices are thick.
    """
    root_lps: NDArray[np.float64]
    """Start of all paths in the airways, LPS in mm."""
    tree: AirwayTree
    """Airway tree in the lumen."""
    tracker: PathTracker
    """Tracker of least-cost paths in the lumen."""
    threshold: float
    """Voxel value at which the lumen ends (HU if the volume is in HU); NaN for a lumen from a file."""
    notes: tuple[str, ...] = ()
    """Texts for the user about limits of the search and about points that were moved into the lumen."""
    wall_levels: tuple[float, float, float] | None = None
    """Limits that decide whether a diagonal step between voxels crosses a wall; None for a lumen from a file.

    The values are the limit of certain air, the level half-way to the wall, and the least rise to the wall; None for a
    given lumen.
    """
    edits: tuple[TreeEdit, ...] = ()
    """Edits by the user since the search, in order."""
    base: Airways | None = None
    """Result of the search before the edits; None without edits."""
    next_id: int | None = None
    """Smallest ID that no branch has had, so that IDs are never reused; None before the first edit."""
    uncertain: tuple[Uncertainty, ...] = ()
    """Places where an airway could not be followed, with reasons, the widest first.

    The last entry, of kind ``fine``, states below which width the CT is unreliable.
    """
    bridges: tuple[NDArray[np.float64], ...] = ()
    """Paths of the bridges (across obstructions) that the user added and did not cut, (n, 3) each, LPS in mm.

    Branches on these paths remain marked as bridges.
    """
    upper_airway_zyx: NDArray[np.uint8] | None = field(default=None, repr=False, compare=False)
    """Mask (nz, ny, nx) of the air above the cricoid (larynx and throat), 1 inside; not part of lumen and tree.

    None if the scan ends below the larynx. Not stored in a case file.
    """
    evidence: PerVolumeCache[Any] = field(default_factory=PerVolumeCache, repr=False, compare=False)
    """Cache of wall evidence in the CT for airways that the search missed, which edits use.

    The evidence is computed at first use and shared by all edited versions of the airways.
    """

    def __post_init__(self) -> None:
        """Raise an error if a field of the airways has an invalid type or value."""
        check_fields(
            self,
            lumen_zyx=mask_array(),
            root_lps=lps_point(),
            tree=instance(AirwayTree, "get one from carina.find_airways"),
            tracker=instance(PathTracker, "get one from carina.find_airways"),
            threshold=_check_threshold,
            notes=each(text_of(20_000)),
            wall_levels=array_of(3, optional=True),
            edits=each(instance(TREE_EDITS, "create one of the tree edits of carina.commands")),
            base=instance(Airways, "get airways from carina.find_airways", optional=True),
            next_id=whole_from(0, 2**31, optional=True),
            uncertain=each(instance(Uncertainty, "get them from carina.find_airways")),
            bridges=each(lps_points()),
            upper_airway_zyx=mask_array(optional=True),
            evidence=instance(PerVolumeCache, "omit it"),
        )

    def __copy__(self) -> Airways:
        """Return a shallow copy, which shares the arrays."""
        return replace(self)

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the constructor and the values from which a pickle restores the airways; masks are compressed."""
        values = {one.name: getattr(self, one.name) for one in fields(self)}
        # If the lumen is the tracker's own array (same grid), it is not stored twice.
        is_same = self.lumen_zyx is self.tracker.lumen_zyx
        values["lumen_zyx"] = None if is_same else PackedMask.of(self.lumen_zyx)
        upper = self.upper_airway_zyx
        values["upper_airway_zyx"] = None if upper is None else PackedMask.of(upper)
        return _airways_of, (values,)

    def __repr__(self) -> str:
        """Return one line with the tree, the root, the threshold and the number of edits."""
        edited = f", {len(self.edits)} edits" if self.edits else ""
        return f"Airways({self.tree!r}, root_lps={as_words(self.root_lps)}, threshold={self.threshold:g}{edited})"

    def _repr_html_(self) -> str:
        """Return an HTML drawing and table of the tree with the notes of the search, for a notebook."""
        badges = {note.words for note in self.badges}
        more = [note for note in self.notes if note not in badges]
        if self.edits:
            more.append(f"{len(self.edits)} manual edits")
        if self.uncertain:
            first = self.uncertain[0].reason
            more.append(f"{len(self.uncertain)} uncertain places; the widest of them: {first}")
        more += [absence.words for absence in self.absent]
        return self.tree.to_html(more)

    @property
    def absent(self) -> tuple[Absence, ...]:
        """Lobes and segments that were not found, with the CT's findings there (:func:`carina.track.find_absent`)."""
        return find_absent(self.tree, self.uncertain, self.tracker.grid.ct)

    @property
    def badges(self) -> tuple[Note, ...]:
        """Permanent notes, such as on a search that was stopped or on a doubtful mask.

        These notes stay with the tree through edits and exports; their texts are in ``notes`` too.
        """
        return self.tree.notes

    @property
    def calibrated_shares(self) -> CalibratedShares | None:
        """Share of the length of airways that the search finds in such thick slices, by calibre; None in thin slices.

        The shares are also None for a segmentation from external software, and for a tree that was stored before the
        shares were introduced.
        """
        return shares_of(self.tree, self.tracker.grid.ct)

    @property
    def report(self) -> tuple[str, ...]:
        """Same as :attr:`notes`."""
        return self.notes


def _airways_of(values: dict[str, Any]) -> Airways:
    """Return the airways from the values in a pickle."""
    lumen, upper = values["lumen_zyx"], values["upper_airway_zyx"]
    values["lumen_zyx"] = values["tracker"].lumen_zyx if lumen is None else lumen.mask_zyx()
    values["upper_airway_zyx"] = None if upper is None else upper.mask_zyx()
    return Airways(**values)
