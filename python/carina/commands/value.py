"""Base classes of commands, questions and messages: frozen values whose bounds are part of their types.

A constructor does not check the bounds. :func:`checked` checks them for code that receives a value from a caller, and
reading a value from JSON also checks them. Both name the wrong field in the error.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any, ClassVar, TypeVar

import msgspec
import msgspec.inspect

from carina.errors import UsageError
from carina.typed_reading import read_plain
from carina.value import FrozenValue

__all__ = [
    "Command",
    "FrozenValue",
    "LocalCommand",
    "all_commands",
    "as_plain",
    "checked",
    "describe_error",
    "snake_case",
    "subclasses",
]


V = TypeVar("V", bound=FrozenValue)
S = TypeVar("S")


def snake_case(name: str) -> str:
    """Return a name in snake case: ``SetTexture`` gives ``set_texture``."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()


class Command(FrozenValue, tag_field="type", tag=snake_case, frozen=True):
    """Request of a user, a program or a device to an open case: ``Case.do`` executes it, the window sends it as JSON.

    The definition of the class registers the command on the wire, in its schema and in the window's types. The code
    that executes the command is in ``carina/session``, in the file of the same subject.
    """

    undo_label: ClassVar[str | None] = None
    """Name of the command in the undo menu.

    None if the command is not a step of undo, or if the step names the changed object itself.
    """
    sets: ClassVar[str | None] = None
    """Field of the look or of the sight that the command sets, if it does nothing else, else None."""

    def setting(self) -> tuple[str | None, Any]:
        """Return the view, if the field has a value for each view, and the new value of the field.

        The new value is the value class that the command extends (``SetCarm`` extends ``Carm``), or its only field.
        """
        fields = {name: getattr(self, name) for name in self.__struct_fields__}
        view = fields.pop("view", None)
        value_class = self.value_class()
        if value_class is not None:
            return view, value_class(**fields)
        (value,) = fields.values()
        return view, value

    @classmethod
    def value_class(cls) -> type[FrozenValue] | None:
        """Return the base class of a command whose own fields are the value; None if it has a value field."""
        bases = (base for base in cls.__bases__ if issubclass(base, FrozenValue))
        return next((base for base in bases if not issubclass(base, Command)), None)


class LocalCommand(Command, frozen=True):
    """Command whose fields refer to objects of this process or machine; it is never sent."""


def subclasses(base: type[S]) -> Iterator[type[S]]:
    """Yield all subclasses of a class, in the order of their definition."""
    for cls in base.__subclasses__():
        yield cls
        yield from subclasses(cls)


def all_commands() -> tuple[type[Command], ...]:
    """Return all classes of commands."""
    return tuple(cls for cls in subclasses(Command) if cls is not LocalCommand)


def checked(value: V) -> V:
    """Check the bounds of a value and return the value with tuples instead of lists and arrays.

    Raises
    ------
    UsageError
        ``command.bounds``: naming the field and what is expected.
    """
    if not isinstance(value, LocalCommand):
        try:
            plain = msgspec.to_builtins(value, enc_hook=as_plain)
        except (TypeError, ValueError, RecursionError) as error:
            raise UsageError(
                f"{_name(value)} contains a value that no command accepts: {error}", code="command.bounds"
            ) from error
        try:
            value = read_plain(plain, type(value))
        except msgspec.ValidationError as error:
            raise UsageError(
                describe_error(error, plain, _name(value), type(value))[1], code="command.bounds"
            ) from error
    problem = value.choice_problem()
    if problem is not None:
        raise UsageError(problem, code="command.choice")
    return value


def as_plain(value: Any) -> Any:
    """Return a number or an array of NumPy as plain Python values, for msgspec."""
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"expected a number, text or a list; found {type(value).__name__}")


def _name(value: FrozenValue) -> str:
    return str(type(value).__struct_config__.tag or type(value).__name__)


BOUND = re.compile(r"Expected `(?:int|float)` (>=|<=|>|<) ([^ ]+)")
LENGTH = re.compile(r"Expected `(\w+)` of (?:at least |at most )?length (>=|<=)? ?(\d+)")
PLACE = re.compile(r" - at `(?:key in )?\$(.*)`$")
WORDS = {
    "int": "a whole number", "float": "a number", "str": "text", "bool": "true or false", "array": "a list",
    "object": "an object", "null": "null",
}  # fmt: skip


def describe_error(error: msgspec.ValidationError, value: Any, where: str, cls: type[Any]) -> tuple[str, str]:
    """Describe an error of a value, as a kind (``field``, ``range`` or ``size``) and one sentence.

    Parameters
    ----------
    error
        Error of msgspec, whose text names Python types.
    value
        Value that was read.
    where
        Name of the value.
    cls
        Class as which the value was read.
    """
    text = str(error)
    place = PLACE.search(text)
    path = place.group(1) if place else ""
    where += path
    if bound := BOUND.match(text):
        limit = "at least" if bound.group(1).startswith(">") else "at most"
        return (
            "range",
            f"{where} must be {limit} {float(bound.group(2)):g}; found {_shortened_value(_value_at_path(value, path))}",
        )
    if text.startswith("Number out of range"):
        return "range", f"{where} is too large"
    if length := LENGTH.match(text):
        kind, side, number = length.groups()
        unit = "characters" if kind == "str" else "entries"
        amount = {">=": "at least ", "<=": "at most ", None: ""}[side] + number
        return "size", f"{where} must have {amount} {unit}; found {len(_value_at_path(value, path))}"
    if "matching regex" in text:
        return "field", f"{where} contains invalid characters"
    if unknown := re.match(r"Object contains unknown field `(.*?)`", text):
        return "field", f"{where} has an unknown field: {unknown.group(1)[:40]!r}"
    if missing := re.match(r"Object missing required field `(.*?)`", text):
        return "field", f"{where} has no field {missing.group(1)!r}"
    if text.startswith("Invalid"):
        found = _shortened_value(_value_at_path(value, path))
        choices = sorted(_accepted_texts(msgspec.inspect.type_info(cls), re.findall(r"\.(\w+)", path)))
        if not choices:
            return "field", f"{where} cannot be {found}"
        accepted = " or ".join([", ".join(choices[:-1]), choices[-1]] if choices[1:] else choices)
        return "field", f"{where} must be {accepted}; found {found}"
    if expected := re.match(r"Expected `(.+?)`, got `(\w+)`", text):
        wanted = " or ".join(WORDS.get(one, one) for one in expected.group(1).split(" | "))
        if expected.group(2) == "null":
            return "field", f"{where} must not be null"
        return "field", f"{where} must be {wanted}; found {WORDS.get(expected.group(2), expected.group(2))}"
    return "field", f"{where}: {text.split(' - at ', maxsplit=1)[0]}"


def _value_at_path(value: Any, path: str) -> Any:
    """Return the part of a value at a path such as ``.views[3].width``, or the dictionary that contains the part."""
    for name, number in re.findall(r"\.(\w+)|\[(\d+)\]", path.split("[...]", maxsplit=1)[0]):
        value = value[name] if name else value[int(number)]
    return value


def _accepted_texts(kind: msgspec.inspect.Type, names: list[str]) -> set[str]:
    """Return the texts that the field with these names accepts; an empty set if it accepts other values."""
    match kind:
        case msgspec.inspect.LiteralType() if not names:
            return {str(value) for value in kind.values}
        case msgspec.inspect.UnionType():
            return set().union(*(_accepted_texts(one, names) for one in kind.types))
        case msgspec.inspect.VarTupleType():
            return _accepted_texts(kind.item_type, names)
        case msgspec.inspect.DictType():
            return _accepted_texts(kind.value_type, names)
        case msgspec.inspect.StructType() if names == [kind.tag_field]:
            return {str(kind.tag)}
        case msgspec.inspect.StructType() if names:
            fields = {field.name: field.type for field in kind.fields}
            return _accepted_texts(fields[names[0]], names[1:]) if names[0] in fields else set()
    return set()


def _shortened_value(value: Any) -> str:
    if isinstance(value, int | float) and not isinstance(value, bool):
        # A huge integer has too many digits for a message.
        return "more" if abs(value) > 1e15 else f"{value:g}"
    return repr(value)[:40]
