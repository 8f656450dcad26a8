"""Files of tasks: the built-in tasks, and tasks that teachers write."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

from carina.errors import UsageError
from carina.plan.instruments.instrument_file import UserFile
from carina.training.task import Task

FORMAT, VERSION = "carina-task", 1
FIELDS = tuple(field.name for field in dataclasses.fields(Task))
BUILT_IN = Path(__file__).parent / "tasks"
DEFAULT_TASK = "inspect-all"
REMEDY = "correct the file; docs/training.md describes its fields"


def task_from_file(path: str | Path) -> Task:
    """Read a task from a JSON file in the format of `task_to_json`; missing fields have their default.

    Raises
    ------
    UsageError
        If the file cannot be read or contains impossible values. The message states the file, the field, the expected
        and the found value (code ``training.task``).
    """
    file = UserFile.read(path, content="one task", code="training.task", remedy=REMEDY)
    file.check(FORMAT, VERSION, FIELDS)
    values = dict(file.document)
    del values["format"], values["version"]
    for name in ("name", "title", "kind"):
        file.text(name)
    for name in ("segments", "branches", "stations", "hints", "place_lps", "aim_lps"):
        found = values.get(name, [])
        if not isinstance(found, list):
            raise file.refusal(name, "a list of numbers" if name.endswith("_lps") else "a list of texts", found)
        values[name] = tuple(found)
    try:
        return Task(**values)
    except UsageError as error:
        raise UsageError(f"{file.where}: {str(error).removeprefix('Task: ')}; {REMEDY}", code=file.code) from None


def task_to_json(task: Task) -> dict[str, Any]:
    """Return a task as plain JSON types, which `task_from_file` reads."""
    values = dataclasses.asdict(task)
    return {
        "format": FORMAT,
        "version": VERSION,
        **{name: list(value) if isinstance(value, tuple) else value for name, value in values.items()},
    }


def task_from_json(document: dict[str, Any], where: str) -> Task:
    """Return the task of a recording from the plain JSON types of `task_to_json`.

    Parameters
    ----------
    document
        The values.
    where
        Description of their source, for messages.

    Raises
    ------
    UsageError
        ``training.task``: if a field is missing, unknown or has an impossible value.
    """
    unknown = document.keys() - {"format", "version", *FIELDS}
    if document.get("format") != FORMAT or document.get("version") != VERSION or unknown:
        raise UsageError(
            f"{where}: task: expected the fields of {FORMAT} version {VERSION}; found {', '.join(sorted(document))}; "
            "name the task of the flight instead",
            code="training.task",
        )
    values: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in document.items()
        if name not in {"format", "version"}
    }
    try:
        return Task(**values)
    except (TypeError, UsageError) as error:
        raise UsageError(
            f"{where}: {str(error).removeprefix('Task: ')}; name the task of the flight instead", code="training.task"
        ) from None


def task_names() -> tuple[str, ...]:
    """Return the names of the built-in tasks."""
    return tuple(sorted(path.stem for path in BUILT_IN.glob("*.json")))


def find_task(wanted: str | Path) -> Task:
    """Return a built-in task by its name, or else the task in a file.

    Raises
    ------
    UsageError
        ``training.task``: if there is neither; the message lists the built-in tasks.
    """
    if str(wanted) in task_names():
        return task_from_file(BUILT_IN / f"{wanted}.json")
    if not Path(wanted).is_file():
        raise UsageError(
            f"task: expected one of {', '.join(task_names())}, or a file; found {str(wanted)!r}; "
            "correct the name or the path",
            code="training.task",
        )
    return task_from_file(wanted)
