"""What commands do stands beside others of their subject; the decorators here tie each to its class."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

from carina.commands import Command
from carina.commands.questions import Question

if TYPE_CHECKING:
    from carina.session.core import SessionCore

__all__ = ["Subject", "answers", "does", "handlers_of"]

F = TypeVar("F", bound=Callable[..., Any])


class Subject:
    """Commands and questions about one thing, and what they keep between two of them.

    Parameters
    ----------
    core
        The open case, its lock, jobs and listeners.
    """

    def __init__(self, core: SessionCore) -> None:
        self.core = core


def does(command: type[Command]) -> Callable[[F], F]:
    """This method does a command; it may return the id of the job that goes on with it."""
    return _marked(command)


def answers(question: type[Question[Any]]) -> Callable[[F], F]:
    """This method answers a question, and changes nothing."""
    return _marked(question)


def _marked(asked: type[Any]) -> Callable[[F], F]:
    def mark(method: F) -> F:
        method.__dict__["handles"] = asked
        return method

    return mark


def handlers_of(subject: object) -> dict[type[Any], Callable[[Any], Any]]:
    """The marked methods of a subject, by what they handle."""
    methods = (getattr(type(subject), name) for name in dir(type(subject)))
    return {m.handles: getattr(subject, m.__name__) for m in methods if hasattr(m, "handles")}
