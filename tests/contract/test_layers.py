"""Tests of the checks of imports and size limits, on sources that violate them."""

from __future__ import annotations

import ast

import check_layers
from carina.render import VIEW_NAMES
from check_layers import (
    ROOT,
    _lineage,
    attributes,
    check_folders,
    check_limits,
    check_python,
    defined_twice,
    files_naming_views,
    public_methods,
    read_rules,
    record_classes,
    repeating,
)
from file_graph import Import

TRACK = ROOT / "python" / "carina" / "track"
RULES = read_rules((ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8"))
FOLDERS = RULES.folders


def one(source: str, target: str) -> Import:
    return Import(TRACK / source, 3, TRACK / target, "import")


def test_imports_in_the_order_of_the_folders_are_accepted():
    below = [
        one("edit/add_branch_path.py", "tree/drawn_parts.py"),
        one("find/growth.py", "intensity_levels.py"),
        one("__init__.py", "edit/edits.py"),
    ]
    assert check_folders(FOLDERS, below) == []


def test_import_against_the_order_of_the_folders_is_refused():
    found = check_folders(FOLDERS, [one("names/tree_shape.py", "edit/add_branch_path.py")])
    assert found == [
        "python/carina/track/names/tree_shape.py:3: track.names imports track.edit; it may import ['tree']"
    ]


def test_folder_cycles_folders_without_a_table_row_and_rows_without_files_are_refused():
    rules = dict(FOLDERS["track"])
    del rules["surface"]
    rules |= {"tree": frozenset({"names"}), "attic": frozenset()}
    assert check_folders({"track": rules}, []) == [
        "ARCHITECTURE.md: python/carina/track has no attic",
        "ARCHITECTURE.md: the folders of track form a circle: tree -> names -> tree",
        "python/carina/track/surface: not in ARCHITECTURE.md; add its row",
    ]


def test_carina_may_not_import_a_package_that_depends_on_it(tmp_path, monkeypatch):
    files = {
        "python/carina/__init__.py": "from carina_haptics import ForceLoop\n",
        "python/carina/session/core.py": "import carina_haptics.haply\n",
        "packages/carina-haptics/python/carina_haptics/haply.py": "from carina.scopes import Pose\n",
        "packages/carina-haptics/python/carina_haptics/force_loop.py": "from carina.session import Session\n",
        "packages/carina-haptics/benchmarks/carina_haptics_bench/pictures.py": "import carina_haptics\n",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    monkeypatch.setattr(check_layers, "ROOT", tmp_path)
    found = [line.partition(";")[0] for line in check_python(RULES)]
    assert found == [
        "packages/carina-haptics/python/carina_haptics/force_loop.py:1: carina_haptics imports session",
        "python/carina/__init__.py:1: __init__ imports carina_haptics",
        "python/carina/session/core.py:1: session imports carina_haptics",
    ]


def classes_of(files: dict[str, str]) -> list[tuple[str, ast.ClassDef]]:
    return [
        (path, node) for path, text in files.items() for node in ast.parse(text).body if isinstance(node, ast.ClassDef)
    ]


def test_check_of_files_that_name_a_view_applies_to_every_view_of_the_view_table():
    assert check_layers.view_names() | check_layers.AMBIGUOUS_VIEWS == set(VIEW_NAMES)


def test_view_name_is_found_as_a_string_a_dictionary_key_or_a_name_prefix():
    files = {
        "python/carina/a.py": 'x = {"drr": 1}  # not "axial"\n',
        "python/carina/b.py": 'x = name.startswith("xray-")\n',
        "python/carina/c.py": '"""A drr in a sentence."""\n',
        "web/src/app/d.ts": "const x = {\n  drr: 1,\n};\n",
        "web/src/app/e.ts": 'const x = view.startsWith("xray") || view === "cut-plane";\n',
    }
    trees = {path: ast.parse(text) for path, text in files.items() if path.endswith(".py")}
    naming = files_naming_views(files, trees)
    assert naming["drr"] == ["python/carina/a.py", "web/src/app/d.ts"]
    assert naming["xray-axial"] == naming["xray-sagittal"] == ["python/carina/b.py", "web/src/app/e.ts"]
    assert naming["cut-plane"] == ["web/src/app/e.ts"]
    assert naming["axial"] == []


def test_record_classes_with_equal_field_names_and_types_are_reported():
    files = {
        "python/carina/a.py": (
            "@dataclass(frozen=True)\nclass Steer:\n    x: float\n    y: float\n    z: float\n"
            "class GoTo(Struct, tag=True):\n    x: float\n    y: float\n    w: int\n"
            "class Named(GoTo):\n    label: str\n"
            "class Plain:\n    x: float\n    y: float\n"
        ),
        "python/carina/b.py": (
            "@dataclass\nclass Other:\n    kind: Literal['other']\n    x: float\n    y: int\n    z: float\n"
        ),
    }
    classes = record_classes(classes_of(files))
    assert {name.partition(":")[2] for name in classes} == {"Steer", "GoTo", "Named", "Other"}
    assert set(repeating(classes)) == {
        "python/carina/a.py:Steer",
        "python/carina/a.py:GoTo",
        "python/carina/b.py:Other",
    }


def test_public_class_name_in_two_files_is_refused_and_a_private_one_accepted():
    classes = classes_of(
        {
            "python/carina/track/one.py": "class Lung: ...\nclass _Part: ...\n",
            "python/carina/plan/two.py": "class Lung: ...\nclass _Part: ...\nclass Nodule: ...\n",
        }
    )
    assert defined_twice(classes) == {"Lung": ["python/carina/track/one.py", "python/carina/plan/two.py"]}


def test_inherited_methods_and_attributes_set_on_self_count_towards_the_limits():
    text = (
        "class Moving:\n    def steer(self): ...\n    def _lock(self): ...\n"
        "class Session(Moving[int]):\n    @property\n    def scene(self): ...\n    async def steer(self): ...\n"
        "class OpenCase:\n    number: int\n    wall: Any = None\n    total: ClassVar[int] = 0\n"
        "    def __init__(self):\n        self.late = 1\n        other.no = 2\n"
    )
    by_name = {node.name: node for _, node in classes_of({"a.py": text})}
    assert public_methods(_lineage(by_name, "Session")) == {"scene", "steer"}
    assert attributes(_lineage(by_name, "OpenCase")) == {"number": "int", "wall": "Any", "late": ""}


def limits_exceeded_by(more: int) -> list[str]:
    """Return the findings in sources that exceed every limit by the given number."""
    record = "@dataclass\nclass {}:\n    a: int\n    b: int\n"
    methods = "".join(f"    def m{n}(self): ...\n" for n in range(15 + more))
    files = {f"python/carina/render/view{n}.py": "x = 'drr'\ny = 'tree'\n" for n in range(4 + more)}
    files["python/carina/session/open_case/open_case.py"] = "class OpenCase:\n" + "".join(
        f"    a{n}: int\n" for n in range(22 + more)
    )
    files["python/carina/session/session.py"] = f"class Session:\n{methods}class Case:\n    def do(self): ...\n"
    files["python/carina/track/twins.py"] = "".join(record.format(f"Twin{n}") for n in range(5 + more))
    return check_limits(files)


def test_source_at_a_size_limit_is_accepted_and_above_it_refused():
    assert limits_exceeded_by(0) == []
    found = limits_exceeded_by(1)
    assert [text.split(" ")[0] for text in found] == ["5", "6", "Session", "OpenCase"]
    assert "'drr'" in found[0] and "Twin5" in found[1] and "16" in found[2] and "23" in found[3]


def test_counted_class_that_is_missing_or_has_an_attribute_without_a_type_is_refused():
    found = check_limits(
        {"python/carina/session/open_case/open_case.py": "class OpenCase:\n    wall: Any\nclass Case:\n    x: int\n"}
    )
    assert found == [
        "no class Session in python/carina: correct the limits in tools/check_layers.py",
        "attributes of OpenCase without a type: wall",
    ]
