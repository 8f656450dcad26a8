"""Tables: values with named columns, for pandas, Arrow and the libraries that read Arrow."""

from __future__ import annotations

import importlib
from collections.abc import Iterable, Mapping, Sequence
from types import ModuleType
from typing import Any, Literal

from carina.errors import CarinaError
from carina.installation import install_command

ColumnKind = Literal["int", "float", "text", "flag"]
Column = tuple[ColumnKind, Sequence[Any]]
"""The kind and the values of a column; None where there is no value."""
Columns = dict[str, Column]

_PANDAS_TYPES = {"int": "Int64", "float": "float64", "text": None, "flag": "boolean"}
_ARROW_TYPES = {"int": "int64", "float": "float64", "text": "string", "flag": "bool_"}


class Tabular:
    """A value that is a table of columns with names; its class documents the columns."""

    __slots__ = ()

    def _columns(self) -> Columns:
        """Return the kind and the values of each column."""
        raise NotImplementedError

    def to_columns(self) -> dict[str, list[Any]]:
        """Return the table as lists by column name, for any library; None where there is no value."""
        return {name: list(values) for name, (_, values) in self._columns().items()}

    def to_pandas(self) -> Any:
        """Return the table as a ``pandas.DataFrame``.

        Whole numbers are of the type ``Int64`` and flags ``boolean``, so that a missing value stays missing.

        Raises
        ------
        CarinaError
            ``table.no-library`` if pandas is not installed; the message states how to install it.
        """
        pandas = _library("pandas")
        return pandas.DataFrame(
            {
                # With an explicit index, a table without rows keeps its columns.
                name: pandas.Series(list(values), dtype=_PANDAS_TYPES[kind], index=range(len(values)))
                for name, (kind, values) in self._columns().items()
            }
        )

    def to_arrow(self) -> Any:
        """Return the table as a ``pyarrow.Table``, which polars, DuckDB and others read.

        Raises
        ------
        CarinaError
            ``table.no-library`` if pyarrow is not installed; the message states how to install it.
        """
        pyarrow = _library("pyarrow")
        return pyarrow.table(
            {
                name: pyarrow.array(list(values), type=getattr(pyarrow, _ARROW_TYPES[kind])())
                for name, (kind, values) in self._columns().items()
            }
        )


def columns_of(rows: Iterable[Mapping[str, Any]], kinds: Mapping[str, ColumnKind]) -> Columns:
    """Return the columns of rows that have a value for each name.

    Examples
    --------
    >>> columns_of([{"id": 0, "name": None}, {"id": 1, "name": "RMB"}], {"id": "int", "name": "text"})
    {'id': ('int', [0, 1]), 'name': ('text', [None, 'RMB'])}
    """
    listed = list(rows)
    return {name: (kind, [row[name] for row in listed]) for name, kind in kinds.items()}


def _library(name: str) -> ModuleType:
    """Import an optional library; the error message contains the command that installs it."""
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name != name:
            raise
        raise CarinaError(
            f"this conversion needs the package {name}, which is not installed; to_columns() returns the same table "
            f"without it. Install {name} with: {install_command(name)}",
            code="table.no-library",
        ) from None
