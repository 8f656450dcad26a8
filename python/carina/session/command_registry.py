"""Registration of command handlers: decorators that assign methods to command and question classes."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

from carina.commands import Command
from carina.commands.questions import Query

if TYPE_CHECKING:
    from carina.session.core import SessionCore

F = TypeVar("F", bound=Callable[..., Any])


class CommandHandlers:
    """Handlers of related commands and questions, with the state that they share.

    Parameters
    ----------
    core
        Core of the session: the open case, its lock, its jobs and its listeners.
    """

    def __init__(self, core: SessionCore) -> None:
        self.core = core


def does(command: type[Command]) -> Callable[[F], F]:
    """Mark a method as the handler of a command; the method may return the ID of the job that continues it."""
    return _marking_decorator(command)


def answers(question: type[Query[Any]]) -> Callable[[F], F]:
    """Mark a method as the handler of a question, which must not change the session."""
    return _marking_decorator(question)


def _marking_decorator(command_type: type[Any]) -> Callable[[F], F]:
    def mark(method: F) -> F:
        method.__dict__["handles"] = command_type
        return method

    return mark


def handlers_of(subject: object) -> dict[type[Any], Callable[[Any], Any]]:
    """Return the methods of an object that :func:`does` and :func:`answers` marked, by command or question class."""
    methods = (getattr(type(subject), name) for name in dir(type(subject)))
    return {m.handles: getattr(subject, m.__name__) for m in methods if hasattr(m, "handles")}
