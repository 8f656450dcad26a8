"""Tests of tables as columns, in pandas and Arrow, and of the message about a missing library."""

from __future__ import annotations

import ast
import importlib.util
import json
import sys
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import carina
from cached_test_data import cached_airways, cached_phantom
from carina.display.tables import Tabular
from carina.errors import CarinaError
from carina.plan import turn_list
from carina.track import AirwayTree, TrackResult

CHEST: dict[str, Any] = {"seed": 4, "spacing_mm": 1.2, "generations": 5, "nodule": True}


@pytest.fixture(scope="module")
def tables() -> dict[str, Tabular]:
    made, airways = cached_phantom(**CHEST), cached_airways(**CHEST)
    measures = carina.measure_tree(made.volume, airways)
    plan = carina.plan_route(made.volume, airways, made.truth["nodule"]["centre_lps"], drives=1)
    tip = airways.tree.tips()[0]
    # The second target is in the lung, far from every airway.
    targets = [tip.tip_lps, (-110.0, 0.0, -60.0)]
    return {
        "tree": airways.tree,
        "measures": measures,
        "sections": measures.of(tip.id),
        "targets": carina.track_paths(made.volume, targets=targets, airways=airways, snap_mm=1.0),
        "plan": plan,
        "turns": turn_list(airways.tree, plan.routes[0]),
    }


NUM_ROWS = {
    "tree": lambda tree: len(tree.branches),
    "measures": lambda measures: len(measures.branches),
    "sections": lambda sections: len(sections.at_mm),
    "targets": lambda found: len(found.targets),
    "plan": lambda plan: len(plan.routes),
    "turns": lambda turns: len(turns.turns),
}
KINDS = list(NUM_ROWS)


@pytest.mark.parametrize("kind", KINDS)
def test_columns_of_every_table_have_plain_types_and_equal_length(kind: str, tables: dict[str, Tabular]) -> None:
    columns = tables[kind].to_columns()
    num_rows = NUM_ROWS[kind](tables[kind])
    assert num_rows > 0
    assert {len(values) for values in columns.values()} == {num_rows}
    # The columns consist of plain types without NaN.
    json.dumps(columns, allow_nan=False)
    kinds = {"int": int, "float": float, "text": str, "flag": bool}
    for name, (of, values) in tables[kind]._columns().items():
        assert all(value is None or type(value) is kinds[of] for value in values), name


def test_tables_of_a_tree_and_of_its_measurements_list_equal_branches(tables: dict[str, Tabular]) -> None:
    tree, measures = tables["tree"].to_columns(), tables["measures"].to_columns()
    for name in ("id", "name", "generation", "parent", "kind"):
        assert tree[name] == measures[name]
    assert tree["name"][0] == "Trachea" and tree["parent"][0] is None
    assert isinstance(tables["tree"], AirwayTree)
    assert tree["tip_z_mm"] == [float(branch.tip_lps[2]) for branch in tables["tree"].branches]
    assert 12.0 < measures["mean_mm"][0] < 24.0


def test_measurements_reused_for_an_edited_tree_have_the_branch_names_of_that_tree(tables: dict[str, Tabular]) -> None:
    made, airways = cached_phantom(**CHEST), cached_airways(**CHEST)
    tip = airways.tree.tips()[0]
    renamed = carina.edit_airways(made.volume, airways, carina.track.RenameBranch(tip.id, "biopsy"))
    table = carina.measure_tree(made.volume, renamed, previous=tables["measures"]).to_columns()  # type: ignore[arg-type]
    assert table["name"][table["id"].index(tip.id)] == "biopsy"


def test_table_row_of_a_target_without_a_path_states_the_reason(tables: dict[str, Tabular]) -> None:
    found = tables["targets"]
    assert isinstance(found, TrackResult)
    columns = found.to_columns()
    assert columns["target"] == [1, 2]
    assert columns["problem"][0] is None and "from the segmented lumen" in columns["problem"][1]
    assert columns["length_mm"][0] > 0.0 and columns["length_mm"][1] is None


@pytest.mark.parametrize(("library", "method"), [("pandas", "to_pandas"), ("pyarrow", "to_arrow")])
def test_message_about_a_missing_data_frame_library_states_its_installation_command(
    library: str, method: str, tables: dict[str, Tabular], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(
        CarinaError, match=f"which is not installed; .*Install {library} with: .* {library}$"
    ) as refused:
        getattr(tables["tree"], method)()
    assert refused.value.code == "table.no-library"


def test_to_pandas_passes_each_column_with_its_type(
    tables: dict[str, Tabular], monkeypatch: pytest.MonkeyPatch
) -> None:
    module = types.ModuleType("pandas")
    module.Series = lambda values, dtype, index: (values, dtype, list(index))  # type: ignore[attr-defined]
    module.DataFrame = dict  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "pandas", module)
    plan = tables["plan"]
    frame = plan.to_pandas()
    columns, rows = plan.to_columns(), list(range(NUM_ROWS["plan"](plan)))
    assert {name: values for name, (values, _, _) in frame.items()} == columns
    assert frame["branch_id"][1:] == ("Int64", rows) and frame["fits"][1:] == ("boolean", rows)
    assert frame["score"][1:] == ("float64", rows) and frame["branch_name"][1:] == (None, rows)


def test_to_arrow_passes_each_column_with_its_type(tables: dict[str, Tabular], monkeypatch: pytest.MonkeyPatch) -> None:
    module = types.ModuleType("pyarrow")
    for name in ("int64", "float64", "string", "bool_"):
        setattr(module, name, lambda name=name: name)
    module.array = lambda values, type: (values, type)  # type: ignore[attr-defined]  # noqa: A006
    module.table = dict  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "pyarrow", module)
    table = tables["plan"].to_arrow()
    assert {name: values for name, (values, _) in table.items()} == tables["plan"].to_columns()
    assert [table[name][1] for name in ("branch_id", "score", "branch_name", "fits")] == [
        "int64", "float64", "string", "bool_",
    ]  # fmt: skip


@pytest.mark.skipif(importlib.util.find_spec("pandas") is None, reason="pandas is not installed")
@pytest.mark.parametrize("kind", KINDS)
def test_pandas_data_frame_has_the_values_and_types_of_the_table(kind: str, tables: dict[str, Tabular]) -> None:
    frame = tables[kind].to_pandas()
    columns = tables[kind].to_columns()
    assert list(frame.columns) == list(columns)
    for name, values in columns.items():
        assert [None if frame[name].isna()[n] else value for n, value in enumerate(frame[name])] == values
    types_of = {"int": "Int64", "float": "float64", "flag": "boolean"}
    for name, (of, _) in tables[kind]._columns().items():
        assert of == "text" or str(frame[name].dtype) == types_of[of]


@pytest.mark.skipif(importlib.util.find_spec("pyarrow") is None, reason="pyarrow is not installed")
@pytest.mark.parametrize("kind", KINDS)
def test_arrow_table_has_the_values_of_the_table(kind: str, tables: dict[str, Tabular]) -> None:
    assert tables[kind].to_arrow().to_pydict() == tables[kind].to_columns()


# From a file to a table

TABLE_OF_BRANCHES = """
volume = carina.open_volume("ct.nii.gz")
table = carina.measure_tree(volume, carina.find_airways(volume)).to_columns()
"""


def looked_up(code: str) -> Iterator[str]:
    """Return the names in code that a beginner must look up, except the module ``carina``."""
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Attribute):
            yield node.attr


def test_table_of_branches_needs_only_three_calls_after_open_volume(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert set(looked_up(TABLE_OF_BRANCHES)) - {"open_volume"} == {"find_airways", "measure_tree", "to_columns"}
    carina.write_phantom(cached_phantom(spacing_mm=3.0, generations=3), tmp_path)
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"carina": carina}
    exec(TABLE_OF_BRANCHES, names)
    assert names["table"]["name"][0] == "Trachea"
    assert np.isfinite(names["table"]["mean_mm"][0])


def test_help_of_each_function_names_the_next_function_to_call() -> None:
    steps = [(carina.open_volume, "find_airways"), (carina.find_airways, "measure_tree")]
    steps += [(carina.measure_tree, "to_pandas"), (carina.find_airways, "to_pandas")]
    for function, next_name in steps:
        _, _, see_also = (function.__doc__ or "").partition("See Also\n")
        assert next_name in see_also.partition("\n\n")[0], (function.__name__, next_name)
