"""Valid arguments of every public function, class and method, and the introspection that lists them."""

from __future__ import annotations

import inspect
import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from dicom_writer import chest, series

import carina
from cached_test_data import cached_phantom, found_airways
from carina.commands import RenameBranch, SetTexture
from carina.commands.questions import VoxelAt
from carina.errors import CarinaError
from carina.navigate import AutoFlight, Recording, case_key
from carina.plan import NeedleErrors, ScoreWeights
from carina.render import (
    AirwayView,
    CutPlaneView,
    DrrView,
    Light,
    PathView,
    Slab,
    SliceView,
    TreeView,
    TriPlaneView,
    XrayView,
)
from carina.scopes import DepthOfField, ImageField, Lens, PathFrames
from carina.track import Branch
from carina.volume import Note

VALUE_CLASSES: tuple[type, ...] = (
    AirwayView, AutoFlight, Branch, CutPlaneView, DepthOfField, DrrView, ImageField, Lens, Light, NeedleErrors, Note,
    PathFrames, PathView, ScoreWeights, Slab, SliceView, TreeView, TriPlaneView, XrayView,
)  # fmt: skip
"""Classes that are arguments of public functions and are not exported by ``carina`` itself."""


class Things:
    """Small chest and results of public functions for it; each result is computed at its first use."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._number = itertools.count()

    def new_path(self, suffix: str) -> Path:
        """Return a path in the temporary folder that no call has used."""
        return self.folder / f"{next(self._number)}{suffix}"

    @cached_property
    def phantom(self) -> Any:
        return cached_phantom(seed=4, spacing_mm=2.5, generations=4, nodule=True)

    @property
    def volume(self) -> carina.Volume:
        return self.phantom.volume

    @cached_property
    def airways(self) -> carina.Airways:
        return found_airways(self.volume)

    @cached_property
    def free_place(self) -> Any:
        return carina.training.free_nodule_position(self.volume, self.airways, diameter_mm=8.0)

    @property
    def tree(self) -> carina.AirwayTree:
        return self.airways.tree

    @cached_property
    def tip(self) -> Branch:
        return self.tree.tips()[0]

    @cached_property
    def route(self) -> Any:
        return self.tree.route_to(self.tip.id)

    @cached_property
    def wall(self) -> carina.WallField:
        return carina.wall_field(self.volume, self.airways)

    @cached_property
    def nodule(self) -> carina.Nodule:
        return carina.grow_nodule(self.volume, self.phantom.truth["nodule"]["centre_lps"])

    @cached_property
    def plan(self) -> carina.Plan:
        return carina.plan_route(self.volume, self.airways, self.nodule, wall=self.wall)

    @cached_property
    def path(self) -> carina.FlightPath:
        return carina.FlightPath(self.route)

    @property
    def short_path(self) -> carina.FlightPath:
        return carina.FlightPath([[0.0, 0.0, 0.0], [0.0, 0.0, -2.0]])

    @cached_property
    def pose(self) -> carina.Pose:
        return self.path.pose_at(20.0)

    def navigator(self) -> carina.Navigator:
        """Return a navigator whose tip follows the path."""
        made = carina.Navigator(self.pose, volume=self.volume)
        made.set_path(self.path)
        made.go_to(20.0)
        return made

    def free_tip(self) -> carina.Navigator:
        return carina.Navigator(self.pose, volume=self.volume)

    def drive(self) -> carina.ScopeDrive:
        return carina.ScopeDrive(self.wall, "ultrathin", self.route.points_lps)

    def scoped_tip(self) -> carina.Navigator:
        made = self.free_tip()
        made.enter_scope(self.drive())
        return made

    @cached_property
    def recording(self) -> Recording:
        """Recording of a tip that stays in the trachea."""
        tip = {"lps_from_camera": self.pose.lps_from_camera.ravel().tolist()}
        return Recording({"case": case_key(self.volume), "tip": tip}, ({"end": 0.5},), complete=True)

    @cached_property
    def renderer(self) -> carina.Renderer:
        return carina.Renderer(self.volume)

    @cached_property
    def ct_file(self) -> Path:
        return carina.write_phantom(self.phantom, self.folder / "phantom")[0]

    @cached_property
    def dicom_folder(self) -> Path:
        return series(self.folder / "dicom", hu=chest()[:3])

    @cached_property
    def tree_file(self) -> Path:
        return carina.write_tree(self.folder / "tree.json", self.tree)

    @cached_property
    def case(self) -> carina.Case:
        return carina.Case.open(self.volume)

    @cached_property
    def small_volume(self) -> carina.Volume:
        return carina.Volume(np.full((12, 12, 12), 40, dtype=np.int16), np.eye(4))

    @cached_property
    def view(self) -> AirwayView:
        return AirwayView(carina.Pose.looking((5.5, 5.5, 5.5), (0, 0, -1)), width=16, height=16)

    @cached_property
    def transfer(self) -> carina.TransferFunction:
        return carina.transfer_preset("endoscopic")

    @cached_property
    def picture(self) -> Any:
        return carina.render_view(self.small_volume, view=self.view)

    @cached_property
    def surface(self) -> Any:
        return carina.render_surface(self.small_volume, pose=self.view.pose, width=16, height=12)

    @cached_property
    def mask(self) -> Any:
        return carina.open_mask(self.ct_file.with_name("lumen.nii.gz"), self.volume)

    @property
    def frames(self) -> PathFrames:
        return PathFrames(np.array([0.0, 1.0]), np.stack([np.eye(4)] * 2))

    def close(self) -> None:
        if "case" in vars(self):
            self.case.close()


@dataclass(frozen=True, slots=True)
class Good:
    """Valid call of a public function, class or method: its arguments."""

    arguments: Callable[[Things], dict[str, Any]]
    owner: Callable[[Things], Any] | None = None
    """Function that makes the object of a method; None for functions, classes and class methods."""
    state: Callable[[Any], Any] | None = None
    """Function that reads the state of the object that the call changes."""


BOX = ((-20.0, -20.0, -20.0), (20.0, 20.0, 20.0))
POSE = carina.Pose.looking((5.5, 5.5, 5.5), (0, 0, -1))
MOVED = carina.breathing.ChestDeformation(np.diag([0.9, 0.9, 0.95, 1.0]))
BALL = (4.0 - np.linalg.norm(np.indices((11, 11, 11)) - 5.0, axis=0)).astype(np.float32)
CORNERS = np.array([[0.0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], dtype=np.uint32)
SMALL = {"width": 16, "height": 12}


def _tip_state(tip: carina.Navigator) -> Any:
    return tip.state()


def _tree(t: Things) -> Any:
    return t.tree


def _path(t: Things) -> Any:
    return t.path


def _flight(t: Things) -> Any:
    return AutoFlight(t.path)


def _volume(t: Things) -> Any:
    return t.volume


def _wall(t: Things) -> Any:
    return t.wall


def _nodule(t: Things) -> Any:
    return t.nodule


def _renderer(t: Things) -> Any:
    return t.renderer


def _case(t: Things) -> Any:
    return t.case


def _nodule_fields(t: Things) -> dict[str, Any]:
    return {name: getattr(t.nodule, name) for name in inspect.signature(carina.Nodule).parameters}


def _plan_fields(t: Things) -> dict[str, Any]:
    return {name: getattr(t.plan, name) for name in inspect.signature(carina.Plan).parameters}


def _airways_fields(t: Things) -> dict[str, Any]:
    return {name: getattr(t.airways, name) for name in inspect.signature(carina.Airways).parameters}


def _branch_fields(t: Things) -> dict[str, Any]:
    return {name: getattr(t.tip, name) for name in inspect.signature(Branch).parameters}


GOOD: dict[str, Good] = {
    # Functions
    "deidentify": Good(lambda t: {"source": t.dicom_folder, "folder": t.new_path("")}),
    "demo_patient": Good(lambda _: {}),
    "edit_airways": Good(
        lambda t: {"volume": t.volume, "airways": t.airways, "edit": RenameBranch(branch_id=t.tip.id, name="own")}
    ),
    "export_airways": Good(lambda t: {"path": t.new_path(".stl"), "volume": t.volume, "airways": t.airways}),
    "find_airways": Good(lambda t: {"volume": t.volume}),
    "generate_mr_phantom": Good(lambda _: {"spacing_mm": 5.0, "generations": 3}),
    "generate_phantom": Good(lambda _: {"spacing_mm": 8.0, "generations": 3, "box_lps": BOX}),
    "grow_nodule": Good(lambda t: {"volume": t.volume, "at_lps": t.nodule.centre_lps}),
    "insert_nodule": Good(
        lambda t: {"volume": t.volume, "airways": t.airways, "centre_lps": t.free_place, "diameter_mm": 8.0}
    ),
    "inspect_path": Good(lambda t: {"path": t.ct_file}),
    "isoregion_map": Good(lambda t: {"volume": t.small_volume}),
    "measure_tree": Good(lambda t: {"volume": t.volume, "airways": t.airways}),
    "open_mask": Good(lambda t: {"path": t.ct_file.with_name("lumen.nii.gz"), "volume": t.volume}),
    "open_volume": Good(lambda t: {"path": t.ct_file}),
    "plan_route": Good(
        lambda t: {"volume": t.volume, "airways": t.airways, "target": t.nodule, "wall": t.wall}
    ),
    "read_tree": Good(lambda t: {"path": t.tree_file}),
    "render_surface": Good(lambda t: {"volume": t.small_volume, "pose": POSE, **SMALL}),
    "render_view": Good(lambda t: {"volume": t.small_volume, "view": "airway", "pose": POSE, **SMALL}),
    "score_recording": Good(
        lambda t: {"volume": t.volume, "airways": t.airways, "recording": t.recording, "wall": t.wall}
    ),
    "show": Good(lambda t: {"source": t.case}),
    "track_paths": Good(lambda t: {"volume": t.volume, "targets": [t.tip.tip_lps], "airways": t.airways}),
    "transfer_preset": Good(lambda _: {"name": "endoscopic"}),
    "wall_field": Good(lambda t: {"volume": t.volume, "airways": t.airways, "spacing_mm": 0.6}),
    "write_film": Good(
        lambda t: {
            "path": t.new_path(".mp4"), "volume": t.small_volume, "flight": t.short_path, "view": t.view,
            "rate_hz": 1.0, "speed_mm_s": 500.0, "progress": False,
        }
    ),
    "write_phantom": Good(lambda t: {"phantom": t.phantom, "directory": t.new_path("")}),
    "write_tree": Good(lambda t: {"path": t.new_path(".json"), "tree": t.tree}),
    # Airways
    "AirwayTree": Good(lambda t: {"branches": t.tree.branches}),
    "AirwayTree.branch": Good(lambda t: {"branch_id": t.tip.id}, _tree),
    "AirwayTree.deformed": Good(lambda _: {"deformation": MOVED}, _tree),
    "AirwayTree.from_json": Good(lambda t: {"document": t.tree.to_json()}),
    "AirwayTree.lineage": Good(lambda t: {"branch_id": t.tip.id}, _tree),
    "AirwayTree.named": Good(lambda _: {"name": "Trachea"}, _tree),
    "AirwayTree.nearest_branch": Good(lambda _: {"point_lps": (0.0, 0.0, 0.0)}, _tree),
    "AirwayTree.route_to": Good(lambda t: {"branch_id": t.tip.id}, _tree),
    "AirwayTree.to_html": Good(lambda _: {"more": ("a line",)}, _tree),
    "Airways": Good(_airways_fields),
    "Branch": Good(_branch_fields),
    "Note": Good(lambda _: {"code": "import.clipped", "words": "clipped"}),
    # Case
    "Case": Good(lambda t: {"case": t.case._case}),
    "Case.ask": Good(lambda _: {"question": VoxelAt(lps=(0.0, 0.0, 0.0))}, _case),
    "Case.do": Good(lambda _: {"command": SetTexture(on=True)}, _case),
    "Case.open": Good(lambda t: {"source": t.ct_file}),
    "Case.render": Good(lambda _: {"view": "axial", **SMALL}, _case),
    "Case.save": Good(lambda t: {"path": t.new_path(".carina")}, _case),
    # Flight
    "AutoFlight": Good(lambda t: {"path": t.path}),
    "AutoFlight.path_mm": Good(lambda _: {"time_s": 1.0}, _flight),
    "AutoFlight.pose_at": Good(lambda _: {"time_s": 1.0}, _flight),
    "FlightPath": Good(lambda t: {"points_lps": t.route}),
    "FlightPath.made_before": Good(lambda t: t.path.made_from() | {"points_lps": t.path.source_lps}),
    "FlightPath.nearest": Good(lambda _: {"point_lps": (0.0, 0.0, 0.0)}, _path),
    "FlightPath.nearest_mm": Good(lambda _: {"point_lps": (0.0, 0.0, 0.0)}, _path),
    "FlightPath.next_fork_mm": Good(lambda _: {"path_mm": 10.0}, _path),
    "FlightPath.pose_at": Good(lambda _: {"path_mm": 10.0}, _path),
    "FlightPath.previous_fork_mm": Good(lambda _: {"path_mm": 10.0}, _path),
    "Navigator": Good(lambda t: {"pose": t.pose}),
    "Navigator.enter_scope": Good(lambda t: {"drive": t.drive()}, Things.free_tip, _tip_state),
    "Navigator.go_to": Good(lambda _: {"path_mm": 10.0}, Things.navigator, _tip_state),
    "Navigator.hold_scope": Good(
        lambda _: {"insertion_mm": 10.0, "roll_rad": 0.1, "flexion_rad": 0.1, "dt_s": 0.1},
        Things.scoped_tip,
        _tip_state,
    ),
    "Navigator.move_by": Good(
        lambda _: {"offset_mm": (0.0, 0.0, 1.0), "turn": np.eye(3)}, Things.free_tip, _tip_state
    ),
    "Navigator.place": Good(lambda t: {"pose": t.pose}, Things.free_tip, _tip_state),
    "Navigator.place_at": Good(lambda _: {"point_lps": (0.0, 0.0, 0.0)}, Things.free_tip, _tip_state),
    "Navigator.restore": Good(
        lambda t: {"state": t.navigator().state(), "path": t.path}, Things.free_tip, _tip_state
    ),
    "Navigator.set_mode": Good(lambda _: {"mode": "free"}, Things.navigator, _tip_state),
    "Navigator.set_operator": Good(lambda _: {"position": "facing"}, Things.navigator, _tip_state),
    "Navigator.set_path": Good(lambda t: {"path": t.path}, Things.free_tip, _tip_state),
    "Navigator.steer": Good(lambda _: {"advance_mm": 1.0}, Things.scoped_tip, _tip_state),
    # Plan
    "NeedleErrors": Good(lambda _: {}),
    "Nodule": Good(_nodule_fields),
    "Nodule.contains": Good(lambda _: {"points_lps": [(0.0, 0.0, 0.0)]}, _nodule),
    "Nodule.distance_mm": Good(lambda _: {"points_lps": [(0.0, 0.0, 0.0)]}, _nodule),
    "Nodule.from_record": Good(lambda t: {"record": t.nodule.to_record()}),
    "Plan": Good(_plan_fields),
    "ScoreWeights": Good(lambda _: {}),
    # Pose and scope
    "DepthOfField": Good(lambda _: {"near_mm": 3.0, "far_mm": 50.0}),
    "ImageField": Good(lambda _: {}),
    "Lens": Good(lambda _: {"model": "pinhole"}),
    "Lens.brown": Good(lambda _: {"k1": -0.1}),
    "Lens.fisheye": Good(lambda _: {"k1": 0.01}),
    "Lens.optics": Good(lambda _: SMALL, lambda _: Lens("pinhole")),
    "PathFrames": Good(lambda _: {"path_mm": np.array([0.0, 1.0]), "lps_from_frame": np.stack([np.eye(4)] * 2)}),
    "PathFrames.at": Good(lambda _: {"path_mm": np.array([0.5])}, lambda t: t.frames),
    "Pose": Good(lambda _: {"lps_from_camera": np.eye(4)}),
    "Pose.carried_by": Good(lambda _: {"deformation": MOVED}, lambda _: POSE),
    "Pose.looking": Good(lambda _: {"at_lps": (1.0, 2.0, 3.0), "look_lps": (0.0, 0.0, -1.0)}),
    "ScopeDrive": Good(lambda t: {"field": t.wall, "scope": "ultrathin", "start_path": t.route.points_lps}),
    "ScopeDrive.drive": Good(
        lambda _: {"insertion_mm": 10.0, "roll_rad": 0.0, "flexion_rad": 0.0, "dt_s": 0.1}, Things.drive
    ),
    "ScopeDrive.place": Good(lambda t: {"path": t.route.points_lps, "insertion_mm": 20.0}, Things.drive),
    "ScopeDrive.set_operator": Good(lambda _: {"operator": "facing"}, Things.drive),
    "WallField": Good(lambda t: {"core": t.wall.core}),
    "WallField.ball_mm": Good(lambda _: {"points_lps": [(0.0, 0.0, 0.0)]}, _wall),
    "WallField.deformed": Good(lambda _: {"deformation": MOVED}, _wall),
    "WallField.distance_mm": Good(lambda _: {"points_lps": [(0.0, 0.0, 0.0)]}, _wall),
    "WallField.with_tube": Good(
        lambda _: {"axis_lps": [(0.0, 0.0, 0.0), (0.0, 0.0, 1.0)], "radius_mm": [1.0, 1.0]}, _wall
    ),
    "WallField.with_ridges": Good(
        lambda _: {
            "plates_lps": np.array([[(10.0, 10.0, 10.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)]]),
            "half_mm": 0.2,
        },
        _wall,
    ),
    "WallField.from_distances": Good(lambda _: {"distance_mm_zyx": BALL, "lps_from_ijk": np.eye(4)}),
    "WallField.from_mesh": Good(lambda _: {"vertices_lps": CORNERS, "triangles": FACES}),
    # Pictures
    "AirwayView": Good(lambda _: {"pose": POSE, **SMALL}),
    "CutPlaneView": Good(lambda _: {"pose": POSE, **SMALL}),
    "DrrView": Good(lambda _: SMALL),
    "Light": Good(lambda _: {}),
    "PathView": Good(lambda t: {"kind": "straightened", "path": t.frames, **SMALL}),
    "Renderer": Good(lambda t: {"volume": t.small_volume}),
    "Renderer.adopt_scene": Good(lambda t: {"scene": t.renderer.scene}, _renderer),
    "Renderer.pick": Good(lambda t: {"view": t.view, "column": 3, "row": 3}, _renderer),
    "Renderer.prepare": Good(lambda _: {}, _renderer),
    "Renderer.render": Good(lambda t: {"view": t.view}, _renderer),
    "Renderer.set_lumen": Good(lambda t: {"lumen_zyx": t.airways.lumen_zyx}, _renderer),
    "Renderer.set_transfer": Good(lambda t: {"transfer": t.transfer}, _renderer),
    "Renderer.surface": Good(lambda t: {"view": t.view}, _renderer),
    "Renderer.use_isoregion_map": Good(lambda _: {"path": None}, _renderer),
    "Renderer.with_chosen_method": Good(lambda t: {"view": t.view}, _renderer),
    "Slab": Good(lambda _: {"thickness_mm": 5.0, "kind": "mean"}),
    "SliceView": Good(lambda _: {"plane": "axial", "centre_lps": (0.0, 0.0, 0.0), **SMALL}),
    "TransferFunction": Good(lambda t: {"points": t.transfer.points}),
    "TransferFunction.from_json": Good(lambda t: {"document": t.transfer.to_json()}),
    "TransferFunction.from_json_text": Good(
        lambda _: {"text": '{"format": "carina-transfer", "version": 1, "unit": "HU", "reference_mm": 1, '
        '"points": [[-1000, 0, 0, 0, 0], [0, 1, 1, 1, 1]]}'}
    ),
    "TreeView": Good(lambda _: SMALL),
    "TriPlaneView": Good(lambda _: {"centre_lps": (0.0, 0.0, 0.0), **SMALL}),
    "XrayView": Good(lambda _: {"axis": "coronal", **SMALL}),
    # Volume
    "Volume": Good(lambda t: {"hu_zyx": t.small_volume.hu_zyx, "lps_from_ijk": np.eye(4)}),
    "Volume.contains_lps": Good(lambda _: {"point_lps": (0.0, 0.0, 0.0)}, _volume),
    "Volume.to_ijk": Good(lambda _: {"points_lps": [(0.0, 0.0, 0.0)]}, _volume),
    "Volume.to_lps": Good(lambda _: {"points_ijk": [(0.0, 0.0, 0.0)]}, _volume),
}  # fmt: skip
"""Each function, ``Class`` (its constructor) and ``Class.method`` with arguments with which the call succeeds."""


def public_calls() -> Iterator[str]:
    """Yield the name of every public function, constructor and method with a parameter."""
    for name in carina.__all__:
        value = getattr(carina, name)
        if inspect.isclass(value) and not issubclass(value, CarinaError):
            yield from calls_of(value)
        elif inspect.isfunction(value):
            yield name
    for cls in VALUE_CLASSES:
        yield from calls_of(cls)


def calls_of(cls: type) -> Iterator[str]:
    """Yield the constructor of a class and its public methods with a parameter."""
    yield cls.__name__
    for name in dir(cls):
        static = inspect.getattr_static(cls, name)
        is_method = inspect.isfunction(static) or isinstance(static, classmethod | staticmethod)
        if name.startswith("_") or not is_method or cls.__name__ in {"AirwayView"}:
            continue
        if parameters_of(cls, name):
            yield f"{cls.__name__}.{name}"


def parameters_of(cls: type, method: str) -> list[inspect.Parameter]:
    """Return the parameters of a method without ``self``."""
    found = [one for one in inspect.signature(getattr(cls, method)).parameters.values() if one.name != "self"]
    return [one for one in found if one.kind is not inspect.Parameter.VAR_KEYWORD]


def class_named(name: str) -> type:
    """Return the class ``name``: a public class or a value class."""
    known = {cls.__name__: cls for cls in VALUE_CLASSES}
    found: type = known[name] if name in known else getattr(carina, name)
    return found


def called(name: str, things: Things) -> tuple[Callable[..., Any], dict[str, Any], Callable[[], Any] | None]:
    """Return the callable ``name`` of :data:`GOOD`, its valid arguments, and a function that reads the changed state.

    The last result is None if the call changes no state.
    """
    good = GOOD[name]
    arguments = good.arguments(things)
    owner_name, _, method = name.partition(".")
    if good.owner is not None:
        owner = good.owner(things)
        state = good.state
        return getattr(owner, method), arguments, None if state is None else lambda: state(owner)
    if method:
        return getattr(class_named(owner_name), method), arguments, None
    return (class_named(name) if name[0].isupper() else getattr(carina, name)), arguments, None
