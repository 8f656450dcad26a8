"""Tests of public values in notebooks and logs: ``repr`` is one short line; notebooks show pictures and tables."""

from __future__ import annotations

import base64
import dataclasses
import importlib
import inspect
import io
import pkgutil
import re
import tempfile
import typing
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import msgspec
import numpy as np
import pytest
import SimpleITK as sitk

import carina
from carina.case import History
from carina.commands import DeviceControls
from carina.disk import Draft, scratch_folder
from carina.display import MAX_CHARS, as_words, one_line
from carina.display.slices import middle_slices
from carina.navigate import AutoFlight, AxesSample, KeyFrame, KeyFrameFlight, Pilot, Recorder, SampleFilter, SampleGate
from carina.phantom import Phantom
from carina.render import AirwayView
from carina.scopes import scope_preset
from carina.session import LocalStore, Session
from carina.track import AirwayTree, Branch, lumen_mesh
from carina.value import FrozenValue
from carina.volume import Note, Volume, VolumeSource

PARTS = sorted(part.name for part in pkgutil.iter_modules(carina.__path__) if not part.name.startswith("_"))
LONG_WORDS = "the slices are not\nwhere the header says; " * 20
UNEVEN = -0.12345678901234567


def public_classes() -> dict[str, type]:
    """Return all public classes of Carina and its parts by part and name, without protocols and errors."""
    found = {}
    for part in ("", *PARTS):
        module = importlib.import_module(f"carina.{part}".rstrip("."))
        for name in getattr(module, "__all__", ()):
            value = getattr(module, name)
            if not inspect.isclass(value) or not value.__module__.startswith("carina."):
                continue
            if not getattr(value, "_is_protocol", False) and not issubclass(value, BaseException):
                found[f"{part}.{name}"] = value
    return found


def is_value(cls: type) -> bool:
    """Return whether a class has named fields."""
    return dataclasses.is_dataclass(cls) or issubclass(cls, msgspec.Struct)


def worst(cls: type) -> object:
    """Return an object of a class whose fields have the longest possible text."""
    if issubclass(cls, msgspec.Struct):
        values = {field.name: largest(str(field.type)) for field in msgspec.structs.fields(cls)}
        if hasattr(cls, "__post_init__"):
            # The class checks its fields, so it is replaced by a class with the same fields and the same ``__repr__``.
            assert cls.__repr__ is FrozenValue.__repr__
            cls = msgspec.defstruct(cls.__name__, [(name, Any) for name in values], bases=(FrozenValue,), frozen=True)
        return cls(**values)
    value = object.__new__(cls)
    for field in dataclasses.fields(cls):
        object.__setattr__(value, field.name, largest(str(field.type)))
    return value


def largest(kind: str) -> object:
    """Return the value with the longest possible text for an annotation."""
    if re.search(r"NDArray|Points|Floats", kind):
        return np.full((900, 3), UNEVEN)
    if kind.startswith("dict"):
        return {f"entry {n}": LONG_WORDS for n in range(50)}
    if re.search(r"tuple\[.*\.\.\.\]|list\[", kind):
        return tuple(Note(str(n), LONG_WORDS) for n in range(300))
    if re.search(r"tuple\[|Point\b|Vec3|Wxyz|Six", kind):
        return (UNEVEN,) * 6
    if re.search(r"\bstr\b", kind):
        return LONG_WORDS
    if "bytes" in kind:
        return b"\0" * 10_000
    if re.search(r"\b(float|int|bool)\b", kind):
        return UNEVEN
    return Note("code", LONG_WORDS) if "Literal" not in kind else "a choice"


# Classes that define ``__repr__``, and the beginning of the text for a small phantom.
WRITTEN = {
    ".Airways": "Airways(AirwayTree(",
    ".AirwayTree": "AirwayTree(",
    ".Pose": "Pose(position_lps=(",
    ".Volume": "Volume(shape_zyx=(",
    "volume.Volume": "Volume(shape_zyx=(",
    "phantom.Phantom": "Phantom(",
    "scopes.Pose": "Pose(position_lps=(",
    "render.Picture": "Picture('airway', 24x16, ",
    "track.Airways": "Airways(AirwayTree(",
    "track.AirwayTree": "AirwayTree(",
    "track.Branch": "Branch(0, 'Trachea', generation 0, ",
    "track.Mesh": "Mesh(",
}


def test_every_public_class_defines_a_repr() -> None:
    assert len(public_classes()) > 200
    # Compiled classes that a part re-exports, such as CancelToken, have no content to show.
    python = {n: c for n, c in public_classes().items() if not c.__module__.startswith("carina._core")}
    assert [name for name, cls in python.items() if cls.__repr__ is object.__repr__] == []


@pytest.mark.parametrize("name", sorted(n for n, c in public_classes().items() if n not in WRITTEN and is_value(c)))
def test_repr_of_a_public_value_is_one_short_line_for_any_content(name: str) -> None:
    text = repr(worst(public_classes()[name]))
    assert "\n" not in text, text
    assert len(text) <= MAX_CHARS, f"{len(text)} characters: {text}"


@dataclass(frozen=True)
class Shown:
    """Public values that a user creates between a CT and a picture."""

    phantom: Phantom
    airways: carina.Airways
    route: typing.Any
    path: carina.FlightPath
    renderer: carina.Renderer
    picture: typing.Any
    surface: typing.Any
    mesh: typing.Any
    wall: typing.Any


@pytest.fixture(scope="module")
def shown() -> Shown:
    phantom = carina.generate_phantom(seed=4, spacing_mm=1.5, generations=3)
    airways = carina.find_airways(phantom.volume)
    tip = max(airways.tree.tips(), key=lambda branch: branch.generation)
    route = airways.tree.route_to(tip.id)
    path = carina.FlightPath(route)
    renderer = carina.Renderer(phantom.volume)
    renderer.set_lumen(airways.lumen_zyx)
    pose = path.pose_at(30.0)
    return Shown(
        phantom=phantom,
        airways=airways,
        route=route,
        path=path,
        renderer=renderer,
        picture=renderer.render(AirwayView.of_scope(scope_preset("generic"), pose, width=24, height=16)),
        surface=carina.render_surface(phantom.volume, pose=pose, lumen_zyx=airways.lumen_zyx, width=24, height=16),
        mesh=lumen_mesh(phantom.volume, airways),
        wall=carina.wall_field(phantom.volume, airways),
    )


def test_repr_of_computed_values_is_one_line(shown: Shown) -> None:
    values = [getattr(shown, field.name) for field in dataclasses.fields(shown)]
    values += [shown.phantom.volume, shown.airways.tree, shown.airways.tracker, *shown.airways.tree.branches]
    values += [shown.path.pose_at(30.0), carina.Navigator(shown.path.pose_at(30.0), volume=shown.phantom.volume)]
    values += [carina.transfer_preset("endoscopic"), scope_preset("generic")]
    for value in values:
        text = repr(value)
        assert "\n" not in text, text
        assert len(text) <= MAX_CHARS, f"{len(text)} characters: {text}"
        assert " object at 0x" not in text, text
        begin = next((b for name, b in WRITTEN.items() if name.endswith(f".{type(value).__name__}")), "")
        if not isinstance(value, Branch) or value.id == 0:
            assert text.startswith(begin)


def test_repr_of_stateful_objects_is_one_line_with_their_state(shown: Shown, tmp_path: Path) -> None:
    name = "very/" * 30
    navigator = carina.Navigator(shown.path.pose_at(30.0), volume=shown.phantom.volume)
    pilot = Pilot(navigator)
    recorder = Recorder(pilot, io.StringIO(), case={}, carina="1", now_s=0.0, view={})
    session = Session(lambda *_: shown.renderer)
    poses = [KeyFrame(None, shown.path.pose_at(mm)) for mm in (0.0, 10.0, 20.0)]
    gate = SampleGate()
    gate.admit("a stick", AxesSample(0.0, (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)), 0.0)
    draft = Draft(tmp_path / "a.json", what="the settings")
    with scratch_folder() as folder:
        values = {
            "AutoFlight(FlightPath(": AutoFlight(shown.path),
            "Draft('": draft,
            "History(0 changes, 0 of them applied)": History("a document"),
            "KeyFrameFlight(3 key frames, ": KeyFrameFlight(poses),
            "LocalStore('very/": LocalStore(Path(name)),
            "Pilot(Navigator(mode='free', at_lps=(": pilot,
            "Recorder(0.0 s, 0 moves, ": recorder,
            "SampleFilter(DeviceControls(": SampleFilter(DeviceControls()),
            "SampleGate(1 devices, held by 'a stick')": gate,
            "Session(no case)": session,
        }
        assert folder.is_dir()
        for begin, value in values.items():
            assert repr(value).startswith(begin), repr(value)
            assert "\n" not in repr(value)
            assert len(repr(value)) <= MAX_CHARS, repr(value)
    draft.discard()
    session.close()


def test_repr_omits_defaults_shows_array_shapes_and_ends_with_an_ellipsis() -> None:
    @one_line
    @dataclass(frozen=True, slots=True)
    class Kept:
        name: str
        points: object = None
        width: float = 1.5
        items: tuple[object, ...] = ()
        secret: str = dataclasses.field(default="no", repr=False)

    name = Kept.__qualname__
    assert repr(Kept("a")) == f"{name}(name='a')"
    many = repr(Kept("a", np.zeros((4, 3), dtype=np.float32), 2.0, (1,) * 9, "yes"))
    assert many == f"{name}(name='a', points=float32[4, 3], width=2, items=<9 of int>)"
    assert as_words([Note("a", "b"), None]) == "[Note(code='a', words='b'), None]"
    assert as_words({"a": 1.0}) == "{'a': 1}"
    assert as_words((1,)) == "(1,)"
    assert as_words(b"abc") == "<3 bytes>"
    assert as_words("a\n" * 50) == repr("a\n" * 29 + "a…")
    assert as_words(len) == "<built-in function len>"
    assert as_words(object()) == "<object>"


# Display in notebooks


def pictures_in(page: str) -> list[np.ndarray]:
    return [
        decoded(base64.b64decode(data)) for data in re.findall(r'src="data:image/png;base64,([A-Za-z0-9+/=]+)"', page)
    ]


def decoded(png: bytes) -> np.ndarray:
    with tempfile.TemporaryDirectory() as place:
        file = Path(place) / "a.png"
        file.write_bytes(png)
        return sitk.GetArrayFromImage(sitk.ReadImage(str(file)))


def test_notebook_shows_a_picture_as_png(shown: Shown) -> None:
    assert np.array_equal(decoded(shown.picture._repr_png_()), shown.picture.rgb)


def lying() -> Volume:
    """Return an oblique anisotropic volume of air with a bright block at the patient's right, anterior and superior."""
    values = np.full((20, 24, 30), -1000, dtype=np.int16)
    spacing = np.array([2.0, 2.5, 3.0])
    a = np.deg2rad(8.0)
    turned = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    matrix = np.eye(4)
    matrix[:3, :3] = turned @ np.diag(spacing)
    matrix[:3, 3] = (-30.0, -25.0, -200.0)
    values[14:, :10, :10] = 400
    source = VolumeSource(
        format="dicom",
        title="DOE^JANE D:/scans/jane",
        notes=(Note("import.lossy", "the pixels were <squeezed>", badge=True), Note("import.other", "not a badge")),
    )
    return Volume(values, matrix, source=source)


def test_volume_slices_in_a_notebook_show_patient_right_and_anterior_on_the_left_and_the_head_above() -> None:
    found = lying()
    axial, coronal, sagittal = middle_slices(
        _all_bright_through_the_middle(found), found.lps_from_ijk, (1500.0, -600.0), height_px=120
    ).values()
    assert max(len(axial), len(coronal), len(sagittal)) == 120
    for name, slice_rgb in (("axial", axial), ("coronal", coronal), ("sagittal", sagittal)):
        rows, columns = np.nonzero(slice_rgb[:, :, 0] > 200)
        assert columns.mean() < slice_rgb.shape[1] * 0.45, name
        assert rows.mean() < len(slice_rgb) * 0.45, name


def _all_bright_through_the_middle(found: Volume) -> np.ndarray:
    """Return values with a bright block round the middle of the volume, so that all three slices cut the block."""
    values = np.full(found.shape_zyx, -1000, dtype=np.int16)
    nz, ny, nx = values.shape
    values[nz // 2 - 1 :, : ny // 2 + 1, : nx // 2 + 1] = 400
    return values


def test_notebook_shows_three_slices_with_grey_window_and_badges_and_no_patient_name() -> None:
    page = lying()._repr_html_()
    ElementTree.fromstring(page.replace("<br>", "<br/>").replace('#000">', '#000"/>'))
    slices = pictures_in(page)
    assert len(slices) == 3
    assert max(len(rgb) for rgb in slices) == 240
    assert "30 × 24 × 20 voxels of 2 × 2.5 × 3 mm, in HU" in page
    assert "window 1500, level -600 HU" in page
    assert "! the pixels were &lt;squeezed&gt;" in page
    assert "not a badge" not in page
    assert "not for diagnosis" in page
    assert "DOE" not in page
    assert "scans" not in page


def test_volume_without_hu_states_this_and_is_shown_in_its_range_of_values() -> None:
    values = np.arange(8 * 9 * 10, dtype=np.int16).reshape(8, 9, 10)
    page = Volume(values, np.eye(4), is_hu=False, not_hu_reason="8-bit data")._repr_html_()
    assert "! not HU: 8-bit data" in page
    assert "window 719, level 359.5<" in page
    assert any(np.ptp(rgb) > 100 for rgb in pictures_in(page))


def tree_of_two(name: str | None = "RB1", kind: str = "tracked") -> AirwayTree:
    def branch(number: int, parent: int | None, ends: list[list[float]], **more: typing.Any) -> Branch:
        points = np.array(ends)
        return Branch(
            id=number,
            parent=parent,
            children=(1,) if number == 0 else (),
            generation=number,
            cost=None,
            points=points,
            radius=np.full(len(points), 4.0 - number),
            **more,
        )

    trachea = branch(0, None, [[0.0, 0.0, 0.0], [0.0, 5.0, -80.0]], name="Trachea", kind="tracked")
    right = branch(1, 0, [[0.0, 5.0, -80.0], [-30.0, 5.0, -110.0]], name=name, kind=kind)
    return AirwayTree((trachea, right), notes=(Note("track.doubt", "the mask leaks", badge=True),))


def test_notebook_shows_a_tree_from_the_front_with_a_table_of_its_branches() -> None:
    page = tree_of_two("<b>mine</b>", "manual")._repr_html_()
    root = ElementTree.fromstring(page.replace("<br>", "<br/>"))
    svg = "{http://www.w3.org/2000/svg}"
    outer, inner = (line.get("points").split() for line in root.iter(f"{svg}polyline"))
    (x0, y0), (x1, y1) = (tuple(map(float, point.split(","))) for point in (outer[0], outer[-1]))
    assert x1 < x0, "patient right on the left"
    assert y1 > y0, "head up"
    assert float(inner[0].split(",")[1]) < y0, "the trachea comes from above"
    rows = [[cell.text for cell in row] for row in root.iter("tr")]
    assert rows == [
        ["branch", "generation", "length, mm", "lumen found, mm"],
        ["Trachea", "0", "80.2", "8.0"],
        ["<b>mine</b>", "1", "42.4", "6.0"],
    ]
    message = "".join(root.itertext())
    assert "2 branches (2 named), 1 tips, generations 0 to 1" in message
    assert "1 branches drawn by hand" in message
    assert "! the mask leaks" in message


def test_notebook_table_of_a_large_tree_lists_only_its_first_branches(shown: Shown) -> None:
    page = shown.airways._repr_html_()
    root = ElementTree.fromstring(page.replace("<br>", "<br/>"))
    assert len(list(root.iter("tr"))) == 1 + 12
    assert f"{len(shown.airways.tree)} branches" in page
    assert "; the first 12 branches are listed" in page
    assert len(page) < 200_000


def classes_of(part: str) -> dict[str, type]:
    """Return the public classes of ``carina`` (empty part) or of one of its parts, without errors and protocols."""
    module = importlib.import_module(f"carina.{part}" if part else "carina")
    classes = {name: getattr(module, name) for name in module.__all__}
    return {
        name: value
        for name, value in classes.items()
        if inspect.isclass(value)
        and value.__module__.startswith("carina.")
        and not issubclass(value, Exception)
        and not getattr(value, "_is_protocol", False)
    }


@pytest.mark.parametrize("part", ["", "volume", "render", "track", "phantom", "export", "cluster", "commands"])
def test_repr_of_every_public_class_contains_no_memory_address(part: str) -> None:
    silent = [name for name, value in classes_of(part).items() if value.__repr__ is object.__repr__]
    assert silent == []
