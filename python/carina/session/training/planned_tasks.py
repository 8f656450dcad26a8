"""Tasks that take their place and instrument from the chosen route of a plan."""

from __future__ import annotations

from dataclasses import replace

from carina.case.document import Document
from carina.training import Task


def planned_task(task: Task, document: Document) -> Task:
    """Return a task of the kind ``reach`` with the tip's place, aim and instrument of the chosen planned route.

    Other tasks, and tasks without such a route, are returned unchanged.
    """
    route = document.route
    if task.kind != "reach" or task.place_lps or route is None or route.needle is None:
        return task
    place, aim = route.needle.ends_lps
    target = next((one for one in document.targets if one.target_id == route.target_id), None)
    scope = None if target is None or target.lesion is None else target.lesion.options.scope
    return replace(task, place_lps=tuple(place), aim_lps=tuple(aim), scope=task.scope or scope)
