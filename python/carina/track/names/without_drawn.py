"""Naming of trees with hand-drawn branches: names are derived from the tree without these branches."""

from __future__ import annotations

import dataclasses

import numpy as np

from carina.track.tree.airway_tree import AirwayTree, Branch


def seen_part(tree: AirwayTree) -> tuple[AirwayTree, dict[int, int]]:
    """Return the tree without its ``manual`` branches and everything below them, and a map of branch IDs.

    A branch that was split only by manual branches is joined again and keeps the ID of its upper piece.

    Returns
    -------
    (AirwayTree, dict)
        The reduced tree, and for each remaining ID the ID of its branch in the reduced tree. The result is ``tree``
        itself if nothing was drawn.
    """
    if all(branch.kind != "manual" for branch in tree.branches[1:]):
        return tree, {branch.id: branch.id for branch in tree.branches}
    by_id = {branch.id: branch for branch in tree.branches}
    place_of = {tree.root.id: tree.root.id}
    made: dict[int, Branch] = {}
    # Parents come before their children.
    for branch in tree.branches:
        if branch.id not in place_of:
            continue
        seen = tuple(child for child in branch.children if by_id[child].kind != "manual")
        own = place_of[branch.id]
        made[own] = _joined(made[own], branch, seen) if own in made else _ending(branch, seen)
        is_one = len(seen) == 1 and len(seen) < len(branch.children) and _is_same(branch, by_id[seen[0]])
        for child in seen:
            place_of[child] = own if is_one else child
    branches = []
    for branch in made.values():
        parent = None if branch.parent is None else place_of[branch.parent]
        children = tuple(child for child in branch.children if place_of[child] == child)
        branches.append(dataclasses.replace(branch, parent=parent, children=children))
    return dataclasses.replace(tree, branches=tuple(branches)), place_of


def carried_names(tree: AirwayTree, named: AirwayTree, place_of: dict[int, int]) -> AirwayTree:
    """Return a tree with the names of its reduced tree: joined pieces share a name, hand-drawn ones have none.

    Names given by the user stay.

    Parameters
    ----------
    tree
        The complete tree.
    named, place_of
        The reduced tree with names, and the map of branch IDs, both from :func:`seen_part`.
    """
    by_id = {branch.id: branch for branch in named.branches}
    made = []
    for branch in tree.branches:
        whole = by_id.get(place_of.get(branch.id, -1))
        if branch.name_from == "person":
            made.append(dataclasses.replace(branch, variant=None if whole is None else whole.variant))
            continue
        if whole is None or whole.name_from == "person":
            made.append(dataclasses.replace(branch, name=None, name_confidence=None, name_from=None, variant=None))
            continue
        made.append(
            dataclasses.replace(
                branch,
                name=whole.name,
                name_confidence=whole.name_confidence,
                name_from=whole.name_from,
                variant=whole.variant,
            )
        )
    return dataclasses.replace(tree, branches=tuple(made), notes=named.notes)


def _is_same(upper: Branch, lower: Branch) -> bool:
    """Return whether two consecutive pieces are one bronchus: of one kind, and the user did not name the lower one."""
    return upper.kind == lower.kind and lower.name_from != "person"


def _ending(branch: Branch, children: tuple[int, ...]) -> Branch:
    return dataclasses.replace(branch, children=children)


def _joined(upper: Branch, lower: Branch, children: tuple[int, ...]) -> Branch:
    walls = None
    if upper.wall_mm is not None and lower.wall_mm is not None:
        walls = np.concatenate([upper.wall_mm, lower.wall_mm[1:]])
    return dataclasses.replace(
        upper,
        points=np.concatenate([upper.points, lower.points[1:]]),
        radius=np.concatenate([upper.radius, lower.radius[1:]]),
        wall_mm=walls,
        children=children,
    )
