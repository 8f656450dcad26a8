"""Folder of the tasks that teachers write, one file each."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from pathlib import Path

from carina.display import one_line
from carina.display.escaped_text import printable
from carina.errors import CarinaError, UsageError
from carina.training.task import Task
from carina.training.task_file import find_task, task_from_file, task_names

SUFFIX = ".json"
MAX_TASKS = 200
MAX_PROBLEM = 1000
"""Maximum displayed length, in characters, of the message about a file."""


@one_line
@dataclass(frozen=True, slots=True)
class FolderTasks:
    """Tasks of a folder, and the files without a usable task."""

    tasks: tuple[Task, ...] = ()
    """Tasks in the order of the names of their files."""
    problems: tuple[str, ...] = ()
    """Message for each other file, with the file, the field, and the expected and the found value."""


class TaskFolder:
    """Tasks of teachers in a folder; a file is read again after a change.

    Parameters
    ----------
    folder
        Folder of the files, which need not exist.

    Examples
    --------
    >>> from carina.training import TaskFolder
    >>> TaskFolder("no-such-folder").read()
    FolderTasks()
    """

    def __init__(self, folder: str | Path) -> None:
        self._folder = Path(folder)
        self._lock = threading.Lock()
        self._state: tuple[tuple[Path, int, int], ...] | None = None
        self._known = FolderTasks()

    def __repr__(self) -> str:
        """Return the number of tasks."""
        return f"TaskFolder({len(self.read().tasks)} tasks)"

    @property
    def folder(self) -> Path:
        """Folder of the files."""
        return self._folder

    def read(self) -> FolderTasks:
        """Return the tasks of the folder, the same object as long as no file has changed."""
        with self._lock:
            state, problem = self._list()
            if state != self._state:
                self._state, self._known = state, _read(state, problem)
            return self._known

    def find(self, wanted: str) -> Task:
        """Return a built-in task or a task of the folder by its name.

        Raises
        ------
        UsageError
            ``training.task``: if there is neither.
        """
        own = self.read().tasks
        if wanted in task_names():
            return find_task(wanted)
        for task in own:
            if task.name == wanted:
                return task
        names = ", ".join((*task_names(), *(task.name for task in own)))
        raise UsageError(f"task: expected one of {names}; found {wanted!r}; correct the name", code="training.task")

    def _list(self) -> tuple[tuple[tuple[Path, int, int], ...], str | None]:
        """Return path, time of change and size of each file, and the reason why the folder cannot be read."""
        found = []
        try:
            for path in sorted(self._folder.glob(f"*{SUFFIX}")):
                stat = path.stat()
                found.append((path, stat.st_mtime_ns, stat.st_size))
        except FileNotFoundError:
            # The folder is missing, or a file was deleted meanwhile; the next call lists the others.
            return tuple(found), None
        except OSError as error:
            return tuple(found), f"the folder of tasks cannot be read: {error.strerror}"
        return tuple(found), None


def _read(files: tuple[tuple[Path, int, int], ...], problem: str | None) -> FolderTasks:
    tasks: dict[str, tuple[Task, str]] = {}
    problems = [] if problem is None else [problem]
    for path, _, _ in files[:MAX_TASKS]:
        try:
            task = task_from_file(path)
        except CarinaError as error:
            problems.append(str(error).replace(str(path), path.name))
            continue
        if not (task.name.isprintable() and task.title.isprintable()):
            problems.append(f"{path.name}: name and title: expected printable characters; found {task.name!r}")
        elif task.name in task_names():
            problems.append(
                f"{path.name}: name: expected a name of your own; found that of the built-in task {task.name}"
            )
        elif task.name in tasks:
            problems.append(
                f"{path.name}: name: expected another name than in {tasks[task.name][1]}; found {task.name}"
            )
        else:
            tasks[task.name] = task, path.name
    if len(files) > MAX_TASKS:
        problems.append(f"the folder of tasks has {len(files)} files; only the first {MAX_TASKS} are listed")
    shown = (printable(words)[:MAX_PROBLEM] for words in problems)
    return FolderTasks(tuple(task for task, _ in tasks.values()), tuple(shown))
