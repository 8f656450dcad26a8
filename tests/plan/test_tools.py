"""Tests of biopsy tools and scopes: the library, tools from a user's file, and refused files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from carina.errors import UsageError
from carina.plan import Tool, scope_from_file, scope_to_json, tool, tool_from_file, tools
from carina.scopes import ScopePreset, scope_preset, scope_presets

OWN: dict[str, Any] = {
    "format": "carina-tool",
    "version": 1,
    "name": "own-needle",
    "title": "Own needle, 21 G",
    "outer_mm": 1.75,
    "reach_mm": 18,
    "pierces": True,
    "rigid_mm": None,
    "basis": "s",
    "source": "its package insert",
}


def written(folder: Path, document: object) -> Path:
    path = folder / "own.json"
    path.write_text(json.dumps(document))
    return path


@pytest.mark.parametrize("one", tools(), ids=lambda one: one.name)
def test_each_tool_of_the_library_is_restored_from_its_file(one: Tool, tmp_path: Path) -> None:
    assert tool_from_file(written(tmp_path, one.to_json())) == one


def test_names_of_library_tools_are_unique_and_figures_from_the_literature_have_a_source() -> None:
    assert len({one.name for one in tools()}) == len(tools())
    for one in tools():
        assert ("s" not in one.basis.replace("rest", "").split(",")[0].split()) or one.source is not None
        assert one.basis == "k" or one.source is not None


def test_user_tool_is_read_from_a_file(tmp_path: Path) -> None:
    own = tool_from_file(written(tmp_path, OWN))
    assert own.outer_mm == 1.75 and own.reach_mm == 18.0 and own.flexion_loss_deg is None
    assert own.passes(2.0) and not own.passes(1.8)
    assert not tool("guide-sheath").passes(2.0)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"outer_mm": -1}, r"own\.json: outer_mm: expected a number above 0 up to 10 mm; found -1"),
        ({"outer_mm": None}, r"outer_mm: expected a number above 0 up to 10 mm; found None"),
        ({"outer_mm": True}, r"outer_mm: expected a number"),
        ({"reach_mm": "18"}, r"reach_mm: expected a number above 0 up to 100 mm; found '18'"),
        ({"rigid_mm": 1e9}, r"rigid_mm: expected 0 to 100 mm, or null; found 1000000000"),
        ({"reach_mm": float("nan")}, r"reach_mm: expected a number"),
        ({"pierces": "yes"}, r"pierces: expected true for a needle, else false; found 'yes'"),
        ({"title": ""}, r"title: expected words, at most 300 letters; found ''"),
        ({"source": 3}, r"source: expected words"),
        ({"version": 2}, r"format and version: expected \"carina-tool\" and 1; found \('carina-tool', 2\)"),
        ({"outer": 1.8}, r"names: expected only .*; found \['outer'\]"),
    ],
)
def test_file_with_impossible_tool_figures_is_refused_with_a_message(
    changes: dict[str, Any], text: str, tmp_path: Path
) -> None:
    with pytest.raises(UsageError, match=text):
        tool_from_file(written(tmp_path, {**OWN, **changes}))


def test_file_without_the_fields_of_a_tool_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"none\.json: expected a JSON file with one instrument"):
        tool_from_file(tmp_path / "none.json")
    broken = tmp_path / "broken.json"
    broken.write_bytes(b"\xff\xfe{")
    with pytest.raises(UsageError, match=r"broken\.json: expected a JSON file with one instrument"):
        tool_from_file(broken)
    with pytest.raises(UsageError, match="the whole: expected an object in braces"):
        tool_from_file(written(tmp_path, [OWN]))
    long = tmp_path / "long.json"
    long.write_text(" " * 200_000)
    with pytest.raises(UsageError, match="at most 100000 bytes"):
        tool_from_file(long)


@pytest.mark.parametrize("one", scope_presets(), ids=lambda one: one.name)
def test_each_scope_of_the_library_is_restored_from_its_file(one: ScopePreset, tmp_path: Path) -> None:
    found = scope_from_file(written(tmp_path, scope_to_json(one)))
    assert scope_to_json(found) == scope_to_json(one)
    assert found.fit_mm == one.fit_mm


def test_figures_missing_in_a_scope_file_are_read_as_none(tmp_path: Path) -> None:
    few = {"format": "carina-scope", "version": 1, "name": "own", "title": "Own", "scope_class": "thin", "basis": "k"}
    found = scope_from_file(written(tmp_path, {**few, "tip_mm": 4.0}))
    assert found.channel_mm is None and found.flexion_deg is None and found.bending_mm is None
    assert found.rigid_tip_mm is None and found.length_mm is None


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"tip_mm": 0.5}, r"own\.json: tip_mm: expected 1\.4 to 7\.8 mm; found 0\.5"),
        ({"tip_mm": 9}, r"tip_mm: expected a number above 0 up to 7\.8 mm; found 9"),
        ({"channel_mm": 5.0}, r"channel_mm: expected less than the tip's 3 mm; found 5\.0"),
        ({"flexion_deg": [210]}, r"flexion_deg: expected two numbers from 0 to 229 degrees, or null; found \[210\]"),
        ({"bending_mm": [50, 30]}, r"bending_mm: expected two numbers from 10 to 100 mm, the shorter first"),
        ({"length_mm": 20}, r"length_mm: expected 100 to 1000 mm, or null; found 20"),
        ({"scope_class": "magic"}, r"scope_class: expected one of diagnostic, .*; found 'magic'"),
    ],
)
def test_scope_file_with_impossible_figures_is_refused_with_a_message(
    changes: dict[str, Any], text: str, tmp_path: Path
) -> None:
    document = {**scope_to_json(scope_preset("ultrathin")), **changes}
    with pytest.raises(UsageError, match=text):
        scope_from_file(written(tmp_path, document))
