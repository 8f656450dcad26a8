"""Route of the options ``--to`` and ``--tree``, through an airway tree that is read from a file or found in the CT."""

from __future__ import annotations

import re
from pathlib import Path

from carina.case.routes import ChosenRoute, route_to_branch, route_to_point, route_to_target
from carina.cli.arguments import parse_point
from carina.cli.console import ProgressCallback, print_note
from carina.cli.opened import OpenedInput
from carina.errors import NoResultError, UsageError
from carina.export import read_tree
from carina.track import AirwayTree

MAX_LISTED_NAMES = 12


def check_destination(to: str | None, view: str) -> str:
    """Raise an error for a missing or invalid ``--to`` before the work begins."""
    if to is None:
        raise UsageError(
            f"the {view} view follows a route; specify its end with --to (a branch name or id, or a point x,y,z)"
        )
    if "," in to:
        parse_point(to, "--to")
    return to


def route_to(source: OpenedInput, to: str, *, tree_file: Path | None, progress: ProgressCallback) -> ChosenRoute:
    """Return the route to a branch tip (name or ID), a point x,y,z (LPS, mm), or a named target of a case.

    The permanent notes of the tree are added to ``source.badges``.

    Raises
    ------
    UsageError
        If the tree does not contain the branch.
    NoResultError
        If no path leads to the point.
    """
    airways = None
    if tree_file is None:
        route = _target_route(source, to)
        airways = source.airways(progress)
        source.badges.add(getattr(airways, "badges", ()))
        if route is not None:
            return route
        tree = airways.tree
    else:
        tree = read_tree(tree_file)
        source.badges.add_tree(tree_file)
    if "," in to:
        point = parse_point(to, "--to")
        if airways is None:
            return route_to_point(tree, point)
        return route_to_target(tree, airways.tracker.path_to(point), "target", "target")
    return route_to_branch(tree, _branch_id(tree, to))


def _target_route(source: OpenedInput, to: str) -> ChosenRoute | None:
    """Return the route to a target of the case; None if no target has this name."""
    document = source.document
    target = None if document is None else next((one for one in document.targets if one.name == to), None)
    if target is not None and target.route is None:
        raise NoResultError(f"--to: no path to the target {to!r}: {target.problem or 'the airways do not reach it'}")
    return None if target is None else target.route


def print_drawn_parts(way: ChosenRoute) -> None:
    """Print a note on stderr about the parts of a route that the CT does not show."""
    if way.drawn.words is not None:
        print_note(f"note: {way.drawn.words}: the CT shows no airway there")


def _branch_id(tree: AirwayTree, to: str) -> int:
    if to in tree.names:
        return tree.named(to).id
    if re.fullmatch(r"\d{1,9}", to):
        return tree.branch(int(to)).id
    names = tree.names
    known = ", ".join(names[:MAX_LISTED_NAMES]) + (", ..." if len(names) > MAX_LISTED_NAMES else "")
    raise UsageError(f"--to: no branch is named {to!r}; named branches: {known or 'none'}; branch ids also work")
