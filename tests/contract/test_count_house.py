"""The counter of the code's structure, on made-up trees: a figure that is told before and after must be right."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

import count_house
from count_house import (
    attributes,
    count,
    file_circles,
    files_naming_views,
    is_product,
    lines_per_part,
    overgrown,
    product,
    public_methods,
    record_classes,
    repeating,
    report,
    rust_structs,
)


def tree(files: dict[str, str]) -> count_house.Tree:
    """Files by path."""
    return product(files.items())


@pytest.mark.parametrize(
    ("path", "counts"),
    [
        ("crates/grid/src/lib.rs", True),
        ("crates/grid/src/packet/lanes.rs", True),
        ("python/carina/track/tree.py", True),
        ("web/src/app/App.tsx", True),
        ("crates/gpu/src/airway.wgsl", True),
        ("crates/grid/src/lens_tests.rs", False),
        ("crates/grid/src/packet/tests.rs", False),
        ("crates/grid/tests/walk.rs", False),
        ("crates/grid/benches/speed.rs", False),
        ("web/src/wire/parse.test.ts", False),
        ("web/src/state/test-case.ts", True),
        ("web/dev/fake_server.py", False),
        ("tests/render/test_views.py", False),
        ("python/carina/_cases/CITATION.txt", False),
        ("docs/glossary.md", False),
    ],
)
def test_product_is_what_a_person_wrote_and_a_user_runs(path: str, counts: bool) -> None:
    assert is_product(path) == counts


def test_lines_leave_out_blank_ones_generated_files_and_tests_inside_rust_files() -> None:
    rust = "fn a() {}\n\nfn b() {}\n#[cfg(test)]\nmod tests {\n    fn c() {\n    }\n}\nfn d() {}\n"
    found = tree(
        {
            "crates/grid/src/lib.rs": rust,
            "python/carina/track/tree.py": "x = 1\n\n# why\ny = 2\n",
            "web/src/wire/messages.ts": "// Generated from messages.py. Do not edit.\nexport {};\n",
        }
    )
    assert lines_per_part(found) == {"crates/grid": 3, "python/carina/track": 3}


def test_a_view_is_named_by_a_string_a_key_or_the_beginning_of_its_family() -> None:
    found = tree(
        {
            "python/carina/a.py": 'x = {"drr": 1}  # not "axial"\n',
            "python/carina/b.py": 'x = name.startswith("xray-")\n',
            "python/carina/c.py": '"""A drr is no name in a sentence."""\n',
            "web/src/app/d.ts": "const x = {\n  drr: 1,\n};\n",
            "web/src/app/e.ts": 'const x = view.startsWith("xray") || view === "cut-plane";\n',
        }
    )
    naming = files_naming_views(found)
    assert naming["drr"] == ["python/carina/a.py", "web/src/app/d.ts"]
    assert naming["xray-axial"] == naming["xray-sagittal"] == ["python/carina/b.py", "web/src/app/e.ts"]
    assert naming["cut-plane"] == ["web/src/app/e.ts"]
    assert naming["axial"] == []


def test_classes_repeat_another_by_names_and_types_of_their_fields() -> None:
    found = tree(
        {
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
    )
    classes = record_classes(found)
    assert {name.partition(":")[2] for name in classes} == {"Steer", "GoTo", "Named", "Other"}
    assert set(repeating(classes, least=1)) == {
        "python/carina/a.py:Steer",  # x and z of three in Other, or x and y in GoTo
        "python/carina/a.py:GoTo",
        "python/carina/b.py:Other",
    }
    assert repeating(classes, least=4) == {}


def test_rust_structs_are_read_with_their_fields() -> None:
    rust = "pub struct Hit {\n    /// Where.\n    pub point: Point,\n    depth: f64,\n}\nstruct Bin(u8);\n"
    classes = rust_structs(tree({"crates/grid/src/a.rs": rust}))
    assert classes == {"crates/grid/src/a.rs:Hit": frozenset({("point", "Point"), ("depth", "f64")})}


def test_methods_are_counted_with_what_a_class_inherits() -> None:
    found = tree(
        {
            "python/carina/session/a.py": "class Moving:\n    def steer(self): ...\n    def _lock(self): ...\n",
            "python/carina/session/b.py": (
                "class Session(Moving[int]):\n    @property\n    def scene(self): ...\n    async def steer(self): ...\n"
            ),
        }
    )
    assert public_methods(found, "Session") == ["scene", "steer"]
    assert public_methods(found, "Case") is None


def test_attributes_are_fields_and_what_is_set_on_self() -> None:
    text = (
        "class OpenCase:\n    number: int\n    wall: Any = None\n    total: ClassVar[int] = 0\n"
        "    def __init__(self):\n        self.late = 1\n        other.no = 2\n"
    )
    assert attributes(tree({"python/carina/a.py": text}), "OpenCase") == {
        "number": "int",
        "wall": "Any",
        "late": "",
    }


def test_circles_are_found_in_three_languages_and_only_inside_a_part() -> None:
    found = tree(
        {
            "python/carina/track/__init__.py": "from carina.track.a import x\n",
            "python/carina/track/a.py": "from carina.track import b\nfrom carina.render.c import y\n",
            "python/carina/track/b.py": "def f():\n    from .a import x\n",
            "python/carina/track/leaf.py": "import carina.track.a\n",
            "python/carina/render/c.py": "from carina.track.a import x\n",
            "crates/grid/src/lib.rs": "mod one;\nmod two;\npub use two::{Two, Other};\nuse crate::one::One;\n",
            "crates/grid/src/one.rs": "// crate::three::Three is only spoken of\nuse crate::{Two, three::Three};\n",
            "crates/grid/src/two.rs": "fn f() { crate::one::g() }\n",
            "crates/grid/src/three.rs": "use crate::four;\n",
            "crates/grid/src/four.rs": "\n#[cfg(test)]\nmod tests {\n    use crate::three::Three;\n}\n",
            "web/src/app/a.tsx": 'import { b } from "./b";\nimport { s } from "../state/s";\n',
            "web/src/app/b.ts": 'import type { A } from "./inner";\n',
            "web/src/app/inner/index.ts": 'export * from "../a";\n',
            "web/src/state/s.ts": 'import { a } from "../app/a";\n',
        }
    )
    assert file_circles(found) == [
        ["crates/grid/src/one.rs", "crates/grid/src/two.rs"],
        ["python/carina/track/a.py", "python/carina/track/b.py"],
        ["web/src/app/a.tsx", "web/src/app/b.ts", "web/src/app/inner/index.ts"],
    ]


def test_the_init_that_only_gathers_a_part_makes_a_circle_once_a_file_imports_from_it() -> None:
    found = tree(
        {
            "python/carina/track/__init__.py": "from carina.track.a import x\n",
            "python/carina/track/a.py": "from carina.track import y\n",
        }
    )
    assert file_circles(found) == [["python/carina/track/__init__.py", "python/carina/track/a.py"]]


def test_a_revision_and_the_folder_it_was_made_from_count_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    source = tmp_path / "python" / "carina" / "session" / "case.py"
    source.parent.mkdir(parents=True)
    source.write_text("class OpenCase:\n    wall: Any\nclass Session:\n    def do(self): ...\n", encoding="utf-8")
    (tmp_path / "README.md").write_text("not product\n", encoding="utf-8")

    def git(*arguments: str) -> None:
        subprocess.run(["git", "-c", "user.name=t", "-c", "user.email=t@t", *arguments], cwd=tmp_path, check=True)

    git("init", "-q")
    git("add", ".")
    git("commit", "-q", "-m", "begin")
    monkeypatch.setattr(count_house, "ROOT", tmp_path)
    assert count_house.main([]) == 0
    now = capsys.readouterr().out
    assert count_house.main(["--at", "HEAD"]) == 0
    assert capsys.readouterr().out == now
    source.write_text("", encoding="utf-8")
    assert count_house.main(["--at", "HEAD", "--json"]) == 0
    assert '"wall": "Any"' in capsys.readouterr().out
    with pytest.raises(SystemExit, match="git knows no revision 'gone'"):
        count_house.main(["--at", "gone"])


def test_the_table_tells_every_figure() -> None:
    text = report(count(tree({"python/carina/session/case.py": "class OpenCase:\n    wall: Any\n"})))
    rows = [" ".join(row.split()) for row in text.splitlines()]
    assert {"attributes of OpenCase 1", "with Any in their type 1", "public methods of Session none"} <= set(rows)


def test_what_has_grown_too_large_is_said_and_what_is_at_its_limit_is_not() -> None:
    def house(more: int) -> list[str]:
        record = "@dataclass\nclass {}:\n    a: int\n    b: int\n"
        files = {f"python/carina/render/view{n}.py": "x = 'drr'\ny = 'tree'\n" for n in range(4 + more)}
        files["python/carina/session/case.py"] = "class OpenCase:\n" + "".join(
            f"    a{n}: int\n" for n in range(22 + more)
        )
        files["python/carina/session/session.py"] = "class Session:\n" + "".join(
            f"    def m{n}(self): ...\n" for n in range(15 + more)
        )
        files["python/carina/track/twins.py"] = "".join(record.format(f"Twin{n}") for n in range(5 + more))
        return overgrown(count(tree(files)))

    assert house(0) == []
    found = house(1)
    assert [words.split(" ")[0] for words in found] == ["5", "6", "Session", "OpenCase"]
    assert "'drr'" in found[0] and "Twin5" in found[1] and "16" in found[2] and "23" in found[3]


def test_an_attribute_without_a_type_and_a_circle_are_said() -> None:
    files = {
        "python/carina/session/case.py": "from carina.session import core\nclass OpenCase:\n    wall: Any\n",
        "python/carina/session/core.py": "from carina.session import case\n",
    }
    assert overgrown(count(tree(files))) == [
        "attributes of OpenCase without a type: wall",
        "files import each other in a circle: python/carina/session/case.py, python/carina/session/core.py",
    ]
