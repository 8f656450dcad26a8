"""Deletion of content rows that no step refers to any more, because their steps were deleted."""

from __future__ import annotations

import sqlite3
from typing import TYPE_CHECKING

from carina.case import json_records as f
from carina.case.compression import from_json, unpack_ints
from carina.case.error_texts import damage_error
from carina.case.schema import CONTENT

if TYPE_CHECKING:
    from carina.case.reading import Rows


def delete_unreferenced_rows(connection: sqlite3.Connection, rows: Rows) -> int:
    """Delete the rows that no step refers to, in a transaction that the caller opened; return their number.

    Raises
    ------
    CaseFileError
        ``case.damaged``: if a row that a step refers to is missing; nothing is deleted then.
    """
    documents = [row[0] for row in connection.execute("SELECT DISTINCT document FROM step")]
    stored = referenced_rows(rows, documents)
    num_deleted = 0
    # Rows that refer to other rows are deleted first.
    for table in reversed(CONTENT):
        unused = [(row,) for row in rows[table] if row not in stored[table]]
        if table == "airways":
            unused.sort(key=lambda row: rows["airways"][row[0]][1] is None)
        connection.executemany(f"DELETE FROM {table} WHERE id = ?", unused)
        num_deleted += len(unused)
    return num_deleted


def referenced_rows(rows: Rows, documents: list[int]) -> dict[str, set[int]]:
    """Return the row numbers, by table, of all rows that documents refer to directly or indirectly."""
    found: dict[str, set[int]] = {table: set() for table in CONTENT}
    decoders = f.decoders()
    waiting = [("document", row) for row in documents]
    # Measures refer to their airways, but airways do not refer to their measures.
    measures = {columns[1]: row for row, columns in rows["measures"].items()}
    while waiting:
        table, row = waiting.pop()
        if row is None or row in found[table]:
            continue
        columns = rows[table].get(row)
        if columns is None:
            raise damage_error(f"row {row} of {table}", "an entry", "none")
        found[table].add(row)
        where = f"row {row} of {table}"
        match table, columns[1:]:
            case "document", (airways, route, transfer, look, targets, keys, _):
                waiting += [("airways", airways), ("route", route)]
                waiting += [("value", value) for value in (transfer, look, targets, keys)]
            case "value", ("targets", text):
                waiting += [("route", target.route) for target in from_json(text, decoders.targets, where)]
            case "route", (*arrays, _):
                waiting += [("array", array) for array in arrays]
            case "airways", (base, lumen, tree, tracker, text):
                facts: f.AirwaysFacts = from_json(text, decoders.airways, where)
                waiting += [("airways", base), ("lumen", lumen), ("tree", tree), ("tracker", tracker)]
                waiting += [("value", value) for value in (*facts.edits, facts.uncertain)]
                waiting += [("array", bridge) for bridge in facts.bridges]
                if row in measures:
                    waiting.append(("measures", measures[row]))
            case "tracker", (lumen, tree, _, _, _, _, nodes, num_nodes):
                waiting += [("lumen", lumen), ("tree", tree), ("array", nodes), ("array", num_nodes)]
            case "measures", (airways, branches, _):
                tree = rows["airways"][airways][3]
                count = rows["tree"][tree][1]
                waiting += [("measured_branch", int(one)) for one in unpack_ints(branches, count, where)]
            case "measured_branch", (sections, *_):
                waiting += [("sections", sections)]
            case "tree", (count, branches, *_):
                waiting += [("branch", int(branch)) for branch in unpack_ints(branches, count, where)]
            case "branch", arrays:
                waiting += [("array", array) for array in arrays]
            case "lumen", (_, _, _, count, _, tiles):
                waiting += [("tile", int(tile)) for tile in unpack_ints(tiles, count, where)]
    return found
