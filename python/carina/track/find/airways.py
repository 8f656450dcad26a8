"""Entry point of airway segmentation: from a CT volume to the airway lumen and its tree."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina._core import LumenTracker
from carina.argument_checks import (
    check_arguments,
    each,
    function,
    instance,
    lps_point,
    mask_array,
    number_from,
    text_of,
)
from carina.display.progress import ProgressChoice, progress_function, shows_progress
from carina.errors import NoResultError, check_type
from carina.track.find.airway_ends import find_uncertain
from carina.track.find.artefact_regions import ArtefactRegions, find_disturbed
from carina.track.find.axis_order import CanonicalOrder
from carina.track.find.chest_size import thread_confidence
from carina.track.find.followed_tips import NOTHING_BEYOND, SOFT_KERNEL, STOPPED
from carina.track.find.given_start import GivenStart
from carina.track.find.growth import doubts_of_given, given_lumen, grow
from carina.track.find.interpolated_slices import with_interpolated_note
from carina.track.find.kernel_sharpness import edge_undershoot_hu
from carina.track.find.mask_doubts import unnamed_where_doubted, with_mask_doubts
from carina.track.find.mucus_plugs import find_filled
from carina.track.find.result import Airways
from carina.track.find.root_checks import refuse_a_root_below_the_carina, refuse_a_root_of_one_lung
from carina.track.find.top_of_trachea import TopOfTrachea, notes_of
from carina.track.find.trachea_search import trachea_in
from carina.track.find.twig_removal import without_twigs
from carina.track.intensity_levels import AirScale, air_scale
from carina.track.names.naming import name_tree
from carina.track.paths.path_grid import PathGrid
from carina.track.paths.rebuilt_tracker import CoreRecipe
from carina.track.paths.tracker import SNAP_MM, PathTracker, Point, as_point, branches_from_rows
from carina.track.progress import Cancel, Stages
from carina.track.tree.airway_tree import AirwayTree, Branch
from carina.track.tree.thick_slices import effective_slice_mm, with_slice_note
from carina.track.tree.trachea_diameter_range import with_size_note
from carina.track.tree.uncertainty import Uncertainty, with_confidence
from carina.volume.model import Note, Volume
from carina.volume.point_check import check_in_volume
from carina.volume.sparse_mask import sparse_mask

__all__ = ["Airways", "doubt_of_totals", "find_airways", "search_grid"]

# Upper limits of the length in mm, the number of branches and the generations of a tree; CTs show 1 to 4 m of airways
# in 100 to 600 branches.
MAX_LENGTH_MM = 12_000.0
# Number of branches above which a tree is rejected as a leak into the lung.
MAX_BRANCHES = 2_500
# Generation above which a tree is rejected as a leak into the lung.
MAX_GENERATION = 40
# Minimum total length in mm of the airways beyond a trachea that divides: main bronchi and lobar bronchi are longer.
MIN_BEYOND_MM = 150.0
# Slices thinner than the first value (mm) are not divided if the rims of the kernel are deeper than the second (HU).
MIN_DIVIDED_SHARP_MM = 1.2
MAX_DIVIDED_RIMS_HU = 15.0
# Slices thinner than the first value (mm) are not divided if the noise in their parts exceeds the second (HU).
MIN_DIVIDED_NOISY_MM = 1.26
MAX_DIVIDED_NOISE_HU = 75.0


def doubt_of_totals(branches: tuple[Branch, ...], *, splits: bool) -> Note | None:
    """Return the note on a tree that is too large for a chest, or too small beyond a dividing trachea; else None.

    Returns None if the totals are plausible.

    Parameters
    ----------
    branches
        Branches of the tree.
    splits
        Whether the trachea was found by its division into two main bronchi, with lung on both sides.
    """
    length_mm = float(sum(branch.length_mm for branch in branches))
    deepest = max(branch.generation for branch in branches)
    if length_mm > MAX_LENGTH_MM or len(branches) > MAX_BRANCHES or deepest > MAX_GENERATION:
        words = (
            f"the segmentation leaked: {length_mm / 1000.0:.0f} m of airway in {len(branches)} branches of {deepest} "
            f"generations is more than any chest contains, so much of it is lung. {SOFT_KERNEL}"
        )
        return Note(STOPPED, words, badge=True)
    beyond_mm = length_mm - branches[0].length_mm
    if splits and beyond_mm < MIN_BEYOND_MM:
        words = (
            f"the search was stopped near the trachea: only {beyond_mm:.0f} mm of airway was found beyond it, although "
            f"the scan contains both lungs. Nearly all airways are missing. {SOFT_KERNEL}"
        )
        return Note(STOPPED, words, badge=True)
    return None


# Minimum number of branches for naming lobes: trachea, two main, five lobar and some segmental bronchi.
MIN_GRAMMAR_BRANCHES = 12


@shows_progress
@check_arguments(
    volume=instance(Volume, "open a volume with carina.open_volume"),
    root_lps=lps_point(optional=True),
    lumen_threshold=number_from(-40_000.0, 40_000.0, optional=True),
    lumen_zyx=mask_array(optional=True),
    notes=each(text_of(20_000)),
    cancel=function,
)
def find_airways(
    volume: Volume,
    *,
    root_lps: Sequence[float] | NDArray[np.float64] | None = None,
    lumen_threshold: float | None = None,
    lumen_zyx: NDArray[np.uint8] | None = None,
    notes: Sequence[str] = (),
    progress: ProgressChoice = None,
    cancel: Cancel | None = None,
) -> Airways:
    """Find the airway lumen and its tree.

    Parameters
    ----------
    volume
        A chest CT, in HU or not.
    root_lps
        Start of the paths, LPS in mm; by default the top of the trachea. A point in the trachea, or in the larynx
        and
        throat above it, selects that trachea: the paths begin at its top. A point outside the lumen is moved to the
        nearest lumen voxel within 5 mm. Required if the trachea is not in the scan. With ``lumen_zyx`` the paths
        begin
        at the point itself.
    lumen_threshold
        Value at which the lumen ends, in the volume's own numbers; by default -800 HU, or a value from the histogram
        if
        the volume is not in HU. If a threshold is given, small airways are not traced by the shape of their walls
        beyond it.
    lumen_zyx
        Lumen mask from another tool, (nz, ny, nx), nonzero inside, on the grid of the volume. The mask replaces the
        automatic lumen. Only the piece that contains the root is used; notes state how much is not connected to that
        piece, and how much of the mask is not air in this CT.
    notes
        Texts that are put before the notes of the search, such as the origin of ``lumen_zyx``.
    progress
        False, True, None or ``f(what, fraction)``. True and None show a progress bar in a terminal or a notebook; False
        shows none. The fraction is None while the progress is unknown.
    cancel
        Function that is called often; the search stops when it returns True.

    Returns
    -------
    Airways
        Lumen, root, tree with generations, names and confidence, path tracker, notes on the limits of the search,
        and
        places where an airway could not be followed.

    Raises
    ------
    NoResultError
        If there is no trachea, no lumen at the root, or the lumen is empty; the message states which.
    UsageError
        If the root is not in the volume, or the threshold leaves no lumen.
    GeometryError
        If ``lumen_zyx`` is not on the volume's grid.
    CancelledError
        If ``cancel()`` returned True.

    See Also
    --------
    carina.measure_tree : measure diameters; its ``to_pandas()`` is a table of the branches.
    carina.track.AirwayTree : ``airways.tree``; its ``to_pandas()`` is a table of the branches without measurements.

    References
    ----------
    Paper 6; docs/algorithms.md.

    Examples
    --------
    >>> import carina
    >>> phantom = carina.generate_phantom(spacing_mm=3.0, generations=3)
    >>> airways = carina.find_airways(phantom.volume)
    >>> airways.tree.root.name
    'Trachea'
    """
    check_type("find_airways", "volume", volume, Volume, "open a volume with carina.open_volume")
    stage = Stages(progress_function(progress), cancel)
    root = None if root_lps is None else as_point(root_lps)
    if root is not None:
        check_in_volume(volume, root, "the root")
    given = None if lumen_zyx is None else given_lumen(volume, lumen_zyx)
    order = CanonicalOrder.of(volume)
    given = None if given is None else order.in_canonical_order(given)
    grid = PathGrid.of(order.volume) if given is not None else search_grid(order.volume)
    given = None if given is None else grid.mask_in_parts(given)
    try:
        found = _find_in_grid(grid, root, lumen_threshold, given, stage)
    except NoResultError:
        if not grid.is_divided or given is not None:
            raise
        # Interpolation may have opened the walls of the trachea: the search is repeated in the original slices.
        found = _find_in_grid(PathGrid(order.volume), root, lumen_threshold, given, stage)
    airways = order.on_stored_grid(found)
    return dataclasses.replace(airways, notes=(*notes, *airways.notes))


def search_grid(volume: Volume) -> PathGrid:
    """Return the grid in which the airways of a CT are searched.

    Thick slices are divided, but not the thin ones of a sharp kernel: the dark rims of such a kernel are not blurred in
    thin slices, and look like airways in the interpolated parts.

    Parameters
    ----------
    volume
        The CT, in canonical order.
    """
    grid = PathGrid.of(volume)
    if not grid.is_divided or max(volume.spacing_mm) >= MIN_DIVIDED_SHARP_MM:
        return grid
    rims_hu = edge_undershoot_hu(volume, air_scale(volume))
    return grid if rims_hu is None or rims_hu <= MAX_DIVIDED_RIMS_HU else PathGrid(volume)


def _find_in_grid(
    grid: PathGrid,
    root: Point | None,
    lumen_threshold: float | None,
    given: NDArray[np.uint8] | None,
    stage: Stages,
    *,
    known: ArtefactRegions | None = None,
) -> Airways:
    """Find the airways in a grid of a volume in canonical order, for :func:`find_airways`.

    Parameters
    ----------
    grid
        Grid of the search.
    root
        Start of the paths, LPS in mm; None to find the trachea.
    lumen_threshold
        Value at which the lumen ends; None for the default.
    given
        Lumen mask from another tool, on the grid; None to find the lumen.
    stage
        Receives progress and cancels the search.
    known
        Disturbed parts of the CT, if they were found before; parts that are closed are not searched.
    """
    if grid.is_divided:
        stage.begin("dividing the slices")
    volume = grid.volume
    given_root = root
    was_given_root = root is not None
    found_notes: list[str] = []
    badges: list[Note] = []
    # The noise is None for a lumen from another tool, because that lumen is not judged by this CT.
    noise: float | None = None
    searched = volume
    leaks = np.empty((0, 3))
    beyond = NOTHING_BEYOND
    size = 1.0
    rims_hu: float | None = None
    # The length of the trachea is None if the root was not found by the division into two main bronchi.
    trachea_mm: float | None = None
    top: TopOfTrachea | None = None
    given_start: GivenStart | None = None
    disturbed = ArtefactRegions(grid)
    if given is not None:
        lumen, levels, end = given, None, float("nan")
        badges += doubts_of_given(volume, lumen)
        if root is None:
            drawn = np.where(lumen != 0, -1000, 40).astype(np.int16)
            trachea = trachea_in(drawn, volume, AirScale(-1000.0, 0.0), stage, painted=True)
            root = trachea.top
            found_notes += trachea.notes
    else:
        disturbed = find_disturbed(grid) if known is None else dataclasses.replace(known, grid=grid)
        grown = grow(disturbed, root, lumen_threshold, stage)
        is_noisy = max(grid.ct.spacing_mm) < MIN_DIVIDED_NOISY_MM and grown.noise > air_scale(volume).span(
            MAX_DIVIDED_NOISE_HU
        )
        if (grown.has_leaked or is_noisy) and grid.is_divided:
            # Interpolation turns noise into rows of dark voxels and opens walls that are intact in the original slices,
            # so these are searched.
            return _find_in_grid(PathGrid(grid.ct), root, lumen_threshold, None, stage, known=disturbed)
        lumen, levels, end, root = grown.lumen, grown.levels, grown.end, grown.root
        searched = grown.searched
        noise, leaks, trachea_mm, top = grown.noise, grown.leaks_lps, grown.trachea_mm, grown.top
        beyond, size, given_start = grown.beyond, grown.size, grown.given_start
        rims_hu = grown.rims_hu
        badges += grown.badges
        found_notes += grown.notes
    assert root is not None
    tracker, rows, branches = _track_lumen(grid, lumen, levels, root, stage)
    if not was_given_root or given_start is not None:
        try:
            refuse_a_root_below_the_carina(volume, branches)
            if trachea_mm is not None:
                is_doubted = given_start is not None and given_start.trachea_is_doubted
                refuse_a_root_of_one_lung(volume, branches, 0.0 if is_doubted else trachea_mm)
        except NoResultError:
            if given_start is None:
                raise
            # The search took a lower bronchus for the trachea, so the tree begins at the given start.
            found_notes += given_start.notes_if_unchanged()
            tracker, rows, branches = _track_lumen(grid, lumen, levels, given_start.point, stage)
            trachea_mm = None
        else:
            found_notes += [] if given_start is None else given_start.notes_if_moved_to(root)
    removed_mm = 0.0
    # Streaks cross each other: after one path through them is removed, the tree may use another one.
    while (ends_mm := disturbed.remove_disturbed_ends(lumen, tracker.core, rows)) > 0.0:
        removed_mm += ends_mm
        tracker, rows, branches = _track_lumen(grid, lumen, levels, as_point(branches[0].points[0]), stage)
    badges += disturbed.notes(removed_mm)
    core = tracker.core
    badges += [] if top is None else notes_of(top, branches)
    tree = AirwayTree(branches, _smooth=tracker.smooth)
    uncertain: tuple[Uncertainty, ...] = ()
    if noise is not None:
        stage.begin("assessing the branches")
        tree = with_confidence(
            searched,
            tree,
            noise,
            beyond.threads_lps,
            thread_share=thread_confidence(size),
            judged=beyond.judged,
            rims_hu=rims_hu,
        )
        if not disturbed.is_closed and disturbed.has_leaked(tree):
            closed = dataclasses.replace(disturbed, is_closed=True)
            # If closing the streaks also closes the trachea, keep the tree that leaked.
            with contextlib.suppress(NoResultError):
                return _find_in_grid(grid, given_root, lumen_threshold, None, stage, known=closed)
        tree = disturbed.with_limited_confidence(tree)
        filled = find_filled(searched, tree, lumen, noise, slice_mm=effective_slice_mm(grid.ct), cancel=stage.cancel)
        uncertain = find_uncertain(searched, tree, leaks, filled)
        total = doubt_of_totals(branches, splits=trachea_mm is not None)
        badges += [] if total is None else [total]
    elif volume.is_hu:
        stage.begin("comparing the segmentation with the CT")
        tree, doubt = with_mask_doubts(volume, tree, tracker.noise_hu, tracker.air_scale)
        badges += [] if doubt is None else [doubt]
    if len(tree) >= MIN_GRAMMAR_BRANCHES:
        tree = name_tree(tree)
    else:
        tree = dataclasses.replace(tree, branches=_name_main_airways(tree.branches))
    if given is not None:
        tree = unnamed_where_doubted(tree)
    tree = with_size_note(tree)
    if given is None:
        tree = with_slice_note(tree, grid.ct)
    # The notes of the tree state that it is unlike a human tree, its size is not calibrated, or thick slices hide
    # airways.
    badges += tree.notes
    tree, interpolated = with_interpolated_note(tree, grid.ct)
    badges += [] if interpolated is None else [interpolated]
    tree = dataclasses.replace(tree, notes=tuple(badges))
    tracker.set_branches(tree.branches, [row["nodes"] for row in rows])
    if core.num_settled < core.num_nodes:
        loose = core.num_nodes - core.num_settled
        found_notes.append(f"{loose} lumen voxels are not connected to the start of the tree")
    root_at = branches[0].points[0].copy()
    stage.begin("airways segmented", 1.0)
    return Airways(
        lumen_zyx=grid.lumen_on_ct(tracker.lumen_zyx, tree.branches),
        root_lps=root_at,
        tree=tree,
        tracker=tracker,
        threshold=end,
        notes=(*found_notes, *(badge.words for badge in badges)),
        wall_levels=levels,
        uncertain=uncertain,
        upper_airway_zyx=None if top is None or top.upper_zyx is None else grid.mask_on_ct(sparse_mask(top.upper_zyx)),
    )


def _track_lumen(
    grid: PathGrid,
    lumen: NDArray[np.uint8],
    levels: tuple[float, float, float] | None,
    root: Point,
    stage: Stages,
) -> tuple[PathTracker, list[dict[str, Any]], tuple[Branch, ...]]:
    """Return the tracker of a lumen from a root, and its branches as rows of the compiled module and as values."""
    stage.begin("measuring the lumen")
    volume = grid.volume
    core = LumenTracker(volume.hu_zyx, volume.lps_from_ijk, lumen, levels=levels, root_lps=root, reach_mm=SNAP_MM)
    stage.begin("calculating the paths")
    core.solve_all(cancel=stage.cancel, progress=stage.share)
    stage.begin("building the branches")
    rows = without_twigs(core.branches(cancel=stage.cancel, progress=stage.share))
    recipe = CoreRecipe(levels, is_edited=False)
    tracker = PathTracker(grid, core, recipe=recipe, lumen_zyx=sparse_mask(lumen))
    return tracker, rows, branches_from_rows(rows)


def _name_main_airways(branches: tuple[Branch, ...]) -> tuple[Branch, ...]:
    """Name the trachea and the main bronchi of a tree that has too few branches for further names.

    The root branch is the trachea if it runs downwards for at least 20 mm and divides into two. The child that leads
    to the patient's right (-x in LPS) is the right main bronchus.
    """
    root = branches[0]
    if len(root.children) != 2 or root.points[0][2] - root.points[-1][2] < 20.0:
        return branches
    one, two = (branches[child] for child in root.children)

    def side_mm(branch: Branch) -> float:
        # Mean position of the branch and everything below it: a main bronchus is short, but its lung is large.
        below = [branch]
        for member in below:
            below.extend(branches[child] for child in member.children)
        points = np.concatenate([member.points for member in below])
        return float(points[:, 0].mean() - root.points[-1][0])

    sides = {branch.id: side_mm(branch) for branch in (one, two)}
    right, left = sorted((one, two), key=lambda branch: sides[branch.id])
    if not sides[right.id] < -10.0 < 10.0 < sides[left.id] or min(len(right.children), len(left.children)) < 2:
        return branches
    names = {root.id: "Trachea", right.id: "RMB", left.id: "LMB"}
    return tuple(
        dataclasses.replace(branch, name=names[branch.id], name_from="anatomy") if branch.id in names else branch
        for branch in branches
    )
