"""Update of the radii of edited branches: a branch whose lumen, centreline or neighbour changed is measured again."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from carina._core import LumenTracker
from carina.track.tree.airway_tree import AirwayTree, Branch
from carina.volume.model import Volume

Box = tuple[NDArray[np.int64], NDArray[np.int64]]
"""First and last voxel (i, j, k) of a box."""

REACH_RADII = 3.5
"""Distance from a branch, in its largest wall distances, within which a change of the lumen affects its sections.

A section extends over 2.5 median distances to the wall, and each of these depends on the nearest wall.
"""
REACH_VOXELS = 6.0


def with_walls(tree: AirwayTree) -> AirwayTree:
    """Return the tree with each branch's distances to the wall as its radii.

    Edits use these distances, because a path must fit into the lumen.
    """
    branches = tuple(dataclasses.replace(branch, radius=branch.wall_distance) for branch in tree.branches)
    return dataclasses.replace(tree, branches=branches)


def with_sections(
    volume: Volume,
    core: LumenTracker,
    branches: Sequence[Branch],
    before: AirwayTree,
    changed: Sequence[Box] | None,
) -> tuple[Branch, ...]:
    """Return branches with radii from sections across the lumen, and with distances to the wall.

    Parameters
    ----------
    volume
        The CT on the grid of the tracker.
    core
        Compiled tracker of the edited lumen.
    branches
        Branches of the edited tree, parents first, with distances to the wall as radii.
    before
        Tree before the edit: the radii of unchanged branches are taken from it.
    changed
        Boxes of voxels in which the lumen or a distance to the wall changed; None: anywhere.

    Returns
    -------
    tuple of Branch
        The same, bit for bit, as with ``changed`` None.
    """
    place_of = {branch.id: place for place, branch in enumerate(branches)}
    parents = [None if branch.parent is None else place_of[branch.parent] for branch in branches]
    old = {branch.id: branch for branch in before.branches}
    moved = np.array([changed is None or _is_new(branch, old) for branch in branches])
    if changed:
        moved |= [_near(volume, branch, old.get(branch.id), changed) for branch in branches]
    by_id = {branch.id: branch for branch in branches}
    wanted = [
        bool(moved[place])
        or _family(branch, by_id) != _family(old[branch.id], old)
        or any(moved[place_of[sibling]] for sibling in _family(branch, by_id)[0])
        for place, branch in enumerate(branches)
    ]
    found = core.section_radii([branch.points for branch in branches], parents, wanted)
    return tuple(
        dataclasses.replace(branch, wall_mm=branch.radius, radius=old[branch.id].radius if radius is None else radius)
        for branch, radius in zip(branches, found, strict=True)
    )


def _is_new(branch: Branch, old: dict[int, Branch]) -> bool:
    """Return whether the points of a branch or its distances to the wall differ from those before the edit."""
    was = old.get(branch.id)
    return was is None or not (
        np.array_equal(was.points, branch.points) and np.array_equal(was.wall_distance, branch.radius)
    )


def _family(branch: Branch, by_id: dict[int, Branch]) -> tuple[tuple[int, ...], bool]:
    """Return the IDs of the branches that start at the same fork as a branch, and whether the branch ends in a fork."""
    siblings = () if branch.parent is None else by_id[branch.parent].children
    return siblings, len(branch.children) > 1


def _near(volume: Volume, branch: Branch, was: Branch | None, changed: Sequence[Box]) -> bool:
    """Return whether a section of a branch reaches into one of the boxes."""
    widest = max(float(branch.radius.max()), 0.0 if was is None else float(was.wall_distance.max()))
    reach = REACH_RADII * widest / np.array(volume.spacing_mm) + REACH_VOXELS
    ijk = volume.to_ijk(branch.points)
    low, high = ijk.min(axis=0) - reach, ijk.max(axis=0) + reach
    return any(bool(((low <= box[1]) & (high >= box[0])).all()) for box in changed)
