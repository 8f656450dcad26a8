"""``carina course``: the learners of this machine, a new learner, their attempts, export and deletion."""

from __future__ import annotations

import sys
from pathlib import Path

from carina.cli.arguments import check_needs, check_output_folder
from carina.cli.console import print_json, print_note, print_result
from carina.config import load_settings
from carina.errors import UsageError
from carina.training import Course, Learner


def report(learner: str | None, *, add: bool, export: Path | None, delete: bool, yes: bool, as_json: bool) -> int:
    """Print the learners or the attempts of one; add a learner; export or delete the attempts of one."""
    course = Course(load_settings().learners_dir)
    if learner is None:
        check_needs("a learner", add=add or None, export=export, delete=delete or None, yes=yes or None)
        learners = course.learners()
        for problem in course.problems():
            print_note(problem)
        if as_json:
            print_json({"learners": [learner_json(one) for one in learners], "problems": list(course.problems())})
        else:
            print_result(
                *([_line(one) for one in learners] or ["no learners; add one in the step Train of the window"])
            )
        return 0
    if not delete:
        check_needs("a deletion (--delete)", yes=yes or None)
    if add:
        check_needs("a learner who is not new (without --add)", export=export, delete=delete or None)
    found = course.add(learner) if add else course.learner(learner)
    if add:
        print_note(f"added {found.name}")
    if delete and not yes and not _is_confirmed(found, as_json=as_json):
        return 0
    if export is not None:
        check_output_folder(export)
        for file in course.export(found.name, export):
            print_note(f"wrote {file}")
    if delete:
        course.remove(found.name)
        print_note(f"deleted {found.name} with {len(found.attempts)} attempts")
    if as_json:
        print_json({**learner_json(found), "attempts": [_attempt_json(found, n) for n in range(len(found.attempts))]})
    elif not delete:
        print_result(_line(found), *found.attempts_csv().splitlines())
    return 0


def _is_confirmed(learner: Learner, *, as_json: bool) -> bool:
    """Return whether the user confirms the deletion of a learner in the terminal.

    Raises
    ------
    UsageError
        Without a terminal.
    """
    what = f"{learner.name} and {len(learner.attempts)} attempts"
    if as_json or not sys.stdin.isatty():
        raise UsageError(f"this deletes {what} from this machine permanently; add --yes to confirm")
    print_note(f"Delete {what} from this machine permanently? Type y to delete:")
    if sys.stdin.readline().strip().lower() in {"y", "yes"}:
        return True
    print_note("nothing was deleted")
    return False


def learner_json(learner: Learner) -> dict[str, object]:
    """Return a learner with the verdict as plain JSON types, without the attempts."""
    return {"name": learner.name, "num_attempts": len(learner.attempts), "mastery": learner.mastery().to_json()}


def _attempt_json(learner: Learner, number: int) -> dict[str, object]:
    attempt = learner.attempts[number].to_json()
    return {name: attempt[name] for name in attempt if name not in {"poses", "statements"}}


def _line(learner: Learner) -> str:
    return f"{learner.name}: {len(learner.attempts)} attempts; {learner.mastery().words}"
