"""The check of who may import whom: what it refuses, it names."""

from __future__ import annotations

from check_layers import ROOT, check_rooms, read_rules
from file_graph import Import

TRACK = ROOT / "python" / "carina" / "track"
ROOMS = read_rules((ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")).rooms


def one(source: str, target: str) -> Import:
    return Import(TRACK / source, 3, TRACK / target, "import")


def test_the_rooms_of_track_may_import_what_stands_below_them():
    below = [
        one("edit/way.py", "tree/drawn.py"),
        one("find/growth.py", "levels.py"),
        one("__init__.py", "edit/edits.py"),
    ]
    assert check_rooms(ROOMS, below) == []


def test_an_import_against_the_order_of_the_rooms_is_refused():
    found = check_rooms(ROOMS, [one("names/shape.py", "edit/way.py")])
    assert found == ["python/carina/track/names/shape.py:3: track.names imports track.edit; it may import ['tree']"]


def test_rooms_in_a_circle_or_without_a_row_or_without_a_folder_are_refused():
    rules = dict(ROOMS["track"])
    del rules["surface"]
    rules |= {"tree": frozenset({"names"}), "attic": frozenset()}
    assert check_rooms({"track": rules}, []) == [
        "ARCHITECTURE.md: python/carina/track has no attic",
        "ARCHITECTURE.md: the rooms of track form a circle: tree -> names -> tree",
        "python/carina/track/surface: not in ARCHITECTURE.md; add its row",
    ]
