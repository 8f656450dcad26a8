"""Cases to save in a file: a small synthetic tree with edits, targets, key frames and view settings."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from edit_case import EditCase, assert_same, edit_case
from edit_sequences import some_edit

from carina.case import (
    CaseFile,
    ChosenKeyFrame,
    Document,
    History,
    Moment,
    SourceFacts,
    StoredMeasures,
    Target,
)
from carina.case.routes import ChosenRoute, default_branch_id, route_to_branch
from carina.commands import AddTarget, EditKeyFrames, EditTree, KeyFrameAdd, SetFov, SetTransfer
from carina.errors import NoResultError, UsageError
from carina.navigate import Navigator
from carina.render import GreyWindow, Sight, transfer_preset
from carina.scopes import Pose, ScopeHold
from carina.session.derived.measurement_cache import MeasuredAirways
from carina.session.targets.retrack import followed_route, tracked_target
from carina.track import Airways, BranchMeasures, PaintLumen, TreeMeasures, edit_airways, measure_tree
from carina.track.edit.undo_storage import FoldedAirways, fold_airways

SOURCE_DIGEST = "ab" * 32


def source_of(case: EditCase) -> SourceFacts:
    return SourceFacts.of(case.volume, SOURCE_DIGEST, path="ct/series", choices={"series": "1"})


class ActiveCase:
    """Simulated user who edits a case without a session."""

    def __init__(self, case: EditCase | None = None) -> None:
        self.case = case or edit_case()
        airways = self.case.airways
        branch_id = default_branch_id(airways.tree)
        assert branch_id is not None
        first = Document(
            transfer=transfer_preset("endoscopic"),
            airways=airways,
            lumen_threshold=None,
            route=route_to_branch(airways.tree, branch_id),
        )
        self.history: History[Document] = History(first)
        self.sight = Sight()
        self.numbers = {"target": 0, "key": 0}
        self.at_s = 0.0
        self.measured = MeasuredAirways()

    @classmethod
    def of(cls, moment: Moment, case: EditCase) -> ActiveCase:
        """Return a simulated user who continues from the saved content of a case."""
        made = cls.__new__(cls)
        made.case, made.history, made.sight = case, moment.history(), moment.sight
        made.numbers, made.at_s = dict(moment.numbers), 100.0
        made.measured = MeasuredAirways(moment.measures)
        return made

    @property
    def document(self) -> Document:
        return self.history.current

    @property
    def airways(self) -> Airways:
        airways: Any = self.document.airways
        return airways

    def change(self, label: str, document: Document, command: Any) -> None:
        self.at_s += 1.25
        self.history.change(label, document, now_s=self.at_s, command=command, at_s=self.at_s)

    def edit(self, kind: str, number: Any) -> None:
        edit = some_edit(kind, self.airways, number, self.case)
        try:
            edited = edit_airways(self.case.volume, self.airways, edit)
        except (NoResultError, UsageError):
            return
        targets = tuple(tracked_target(edited, target) for target in self.document.targets)
        route = followed_route(edited, self.document.route, targets)
        self.change(
            f"edit {kind}", replace(self.document, airways=edited, targets=targets, route=route), EditTree(edit)
        )

    def target(self, number: Any) -> None:
        tips = self.airways.tree.tips()
        lps = tuple(float(v) + 0.3 for v in tips[number(len(tips))].points[-1])
        self.numbers["target"] += 1
        name = f"target-{self.numbers['target']}"
        target = tracked_target(self.airways, Target(name, "Ziel größer 7", lps))  # type: ignore[arg-type]
        route = target.route or self.document.route
        document = replace(self.document, targets=(*self.document.targets, target), route=route)
        self.change(f"add {name}", document, AddTarget(lps))  # type: ignore[arg-type]

    def key(self, number: Any) -> None:
        self.numbers["key"] += 1
        turn = 0.1 * number(60)
        pose = Pose.looking((1.0 / 3.0, -turn, turn), (np.cos(turn), np.sin(turn), -0.5))
        frames = (*self.document.key_frames.frames, ChosenKeyFrame(f"key-{self.numbers['key']}", pose, None, None))
        self.change(
            "add key frame",
            replace(self.document, key_frames=replace(self.document.key_frames, frames=frames)),
            EditKeyFrames(KeyFrameAdd()),
        )

    def look(self, number: Any) -> None:
        if number(2):
            fov = 80.0 + number(50) / 7.0
            look = dataclasses.replace(self.document, look=_with(self.document.look, fov_deg=fov))
            self.change("field of view", look, SetFov(fov))
        else:
            preset = ("ct-grey", "endoscopic", "paper")[number(3)]
            self.change(
                "transfer function", replace(self.document, transfer=transfer_preset(preset)), SetTransfer(preset)
            )

    def measure(self) -> None:
        """Measure the shown airways, starting from the measures of the previous step, as a session does."""
        if self.measured.of(self.airways) is not None:
            return
        before = self.history.documents()[max(self.history.position - 1, 0)].airways
        previous = whole_measures(self.measured.of(before))
        self.measured.add(self.airways, measure_tree(self.case.volume, self.airways, previous=previous))

    def gaze(self, number: Any) -> None:
        self.sight = _with(self.sight, crosshair_lps=(1.0, number(7) / 3.0, -2.0), window=GreyWindow(1400.0, -500.5))

    def undo(self) -> None:
        self.history.undo()
        self.unfold()

    def redo(self) -> None:
        self.history.redo()
        self.unfold()

    def unfold(self) -> None:
        airways: Any = self.document.airways
        if isinstance(airways, FoldedAirways):
            whole = airways.unfold()
            self.history.amend(lambda d: replace(d, airways=whole) if d.airways is airways else d)
            self.measured.move_to(airways, whole)

    def fold(self) -> None:
        """Compress the airways of distant undo steps as a session does."""
        folded: dict[int, Any] = {}

        def fold(document: Document) -> Document:
            airways: Any = document.airways
            if isinstance(airways, FoldedAirways) or airways.base is None:
                return document
            if id(airways) not in folded:
                folded[id(airways)] = fold_airways(airways)
                self.measured.move_to(airways, folded[id(airways)])
            return replace(document, airways=folded[id(airways)])

        self.history.fold_far(lambda d: d.airways, 2, fold)

    def moment(self) -> Moment:
        navigator = Navigator(Pose.looking((1.0, 2.0, 3.0), (0.1, 0.2, -1.0)), volume=self.case.volume)
        return Moment(
            first=self.history.first,
            steps=self.history.steps,
            position=self.history.position,
            sight=self.sight,
            tip=navigator.state(),
            scope=ScopeHold(12.5, 0.1, -0.2) if self.history.position % 2 else None,
            search_status="found",
            search_words="words; größer",
            person_moved=True,
            numbers=dict(self.numbers),
            measures=self.measured.retain_only(d.airways for d in self.history.documents()),
        )


def _with(value: Any, **changes: Any) -> Any:
    import msgspec

    return msgspec.structs.replace(value, **changes)


ACTS = (
    "add",
    "cut",
    "bridge",
    "root",
    "fork",
    "paint",
    "erase",
    "smooth",
    "rename",
    "target",
    "key",
    "look",
    "gaze",
    "undo",
    "redo",
    "fold",
    "measure",
)


def act(active_case: ActiveCase, name: str, number: Any) -> None:
    """Let the simulated user perform the action ``name``; ``number(n)`` chooses one of n values."""
    if name in {"undo", "redo", "fold", "measure"}:
        getattr(active_case, name)()
    elif name in {"target", "key", "look", "gaze"}:
        getattr(active_case, name)(number)
    else:
        active_case.edit(name, number)


def save_steps(file: CaseFile, active_case: ActiveCase, names: Sequence[str]) -> None:
    """Make the named changes, with numbers from a fixed seed, and save the case after each change."""
    rng = np.random.default_rng(11)
    for name in names:
        act(active_case, name, lambda n: int(rng.integers(n)))
        file.save(active_case.moment())


def load_lazy_parts(moment: Moment, documents: Sequence[Document], case: EditCase) -> None:
    """Load the parts of a case state that are read at first use: airways, frames of routes, and measures."""
    for document in documents:
        if document.airways is not None:
            whole(document.airways, case)
        for route in (document.route, *(target.route for target in document.targets)):
            if route is not None:
                _ = route.frames
    for _, measures in moment.measures:
        assert isinstance(measures, StoredMeasures)
        measures.load()


def assert_same_route(found: ChosenRoute | None, expected: ChosenRoute | None) -> None:
    if expected is None:
        assert found is None
        return
    assert found is not None
    for field in dataclasses.fields(ChosenRoute):
        one, other = getattr(found, field.name), getattr(expected, field.name)
        if isinstance(other, np.ndarray):
            np.testing.assert_array_equal(one, other)
            assert one.dtype == other.dtype
        elif field.name == "path":
            assert one.made_from() == other.made_from()
            np.testing.assert_array_equal(one.points_lps, other.points_lps)
        else:
            assert one == other, field.name
    np.testing.assert_array_equal(found.frames.lps_from_frame, expected.frames.lps_from_frame)


def whole(airways: Any, case: EditCase) -> Airways:
    found: Airways = airways.unfold() if isinstance(airways, FoldedAirways) else airways
    return found


def assert_same_document(found: Document, expected: Document, case: EditCase) -> None:
    assert found.transfer.to_json() == expected.transfer.to_json()
    assert (found.look, found.lumen_threshold) == (expected.look, expected.lumen_threshold)
    assert found.key_frames.flying == expected.key_frames.flying
    for one, other in zip(found.key_frames.frames, expected.key_frames.frames, strict=True):
        assert (one.key_id, one.name, one.speed_mm_s) == (other.key_id, other.name, other.speed_mm_s)
        np.testing.assert_array_equal(one.pose.lps_from_camera, other.pose.lps_from_camera)
    assert_same_route(found.route, expected.route)
    for one, other in zip(found.targets, expected.targets, strict=True):
        assert replace(one, route=None) == replace(other, route=None)
        assert_same_route(one.route, other.route)
    if expected.airways is None:
        assert found.airways is None
    else:
        assert_same_airways(whole(found.airways, case), whole(expected.airways, case))


def assert_same_airways(found: Airways, expected: Airways) -> None:
    assert_same(found, expected)
    assert (found.notes, found.wall_levels, found.badges) == (expected.notes, expected.wall_levels, expected.badges)
    np.testing.assert_equal(found.threshold, expected.threshold)
    assert found.tracker.root_ijk == expected.tracker.root_ijk
    assert [(b.name_confidence, b.variant) for b in found.tree.branches] == [
        (b.name_confidence, b.variant) for b in expected.tree.branches
    ]
    if expected.base is not None:
        assert found.base is not None
        assert found.base.base is None
        np.testing.assert_array_equal(found.base.lumen_zyx, expected.base.lumen_zyx)


def write_sample_file(path: Any) -> None:
    """Write a case with all kinds of content; this function makes the files in the folder ``sample_files``."""
    active_case = ActiveCase()
    rng = np.random.default_rng(7)
    acts = "measure target key cut measure look rename paint measure key undo redo add measure target gaze undo"
    with CaseFile.create(path, source_of(active_case.case)) as file:
        for name in acts.split():
            act(active_case, name, lambda n: int(rng.integers(n)))
            file.save(active_case.moment())
        with file.record("first flight", begun_s=5.0) as recording:
            recording.write('{"format":"carina-recording","version":1}\n{"t":2.0,"view":{}}\n{"end":2.0}\n')
        file.set_extra("plan", ({"words": "größer"},))
        file.write_copy(path.with_name(f"{path.stem}-whole.carina"), ct_place="ct/series")


def _read_again(command: Any) -> Any:
    """Return a command as it is read from the file; None for a brush that no window can send (below 0.1 mm)."""
    edit = getattr(command, "edit", None)
    return None if isinstance(edit, PaintLumen) and edit.radius_mm < 0.1 else command


def whole_measures(measures: Any) -> TreeMeasures | None:
    found: TreeMeasures | None = measures.load() if isinstance(measures, StoredMeasures) else measures
    return found


def assert_same_measures(found: Any, expected: Any) -> None:
    """Assert that two measurements are equal bit for bit, including the keys that an edit reuses."""
    one, other = whole_measures(found), whole_measures(expected)
    if other is None:
        assert one is None
        return
    assert one is not None
    assert (one.forks, one.blur_mm, one.noise, one.notes, one._keys) == (
        other.forks, other.blur_mm, other.noise, other.notes, other._keys,
    )  # fmt: skip
    for branch, own in zip(one.branches, other.branches, strict=True):
        for field in dataclasses.fields(BranchMeasures):
            mine, theirs = getattr(branch, field.name), getattr(own, field.name)
            if isinstance(theirs, np.ndarray):
                np.testing.assert_array_equal(mine, theirs)
                assert (mine.dtype, mine.shape) == (theirs.dtype, theirs.shape), field.name
            else:
                assert mine == theirs, field.name


def _measures(moment: Moment) -> list[Any]:
    """Return the stored measures of each document's airways."""
    measured = MeasuredAirways(moment.measures)
    return [measured.of(document.airways) for document in moment.history().documents()]


def assert_same_moment(found: Moment | None, expected: Moment, case: EditCase, *, deep: bool = True) -> None:
    """Assert that the contents of two cases are equal bit for bit; with ``deep`` false, only their shown documents."""
    assert found is not None
    for name in ("position", "sight", "tip", "scope", "search_status", "search_words", "person_moved", "numbers"):
        assert getattr(found, name) == getattr(expected, name), name
    assert [(s.label, s.command, s.at_s) for s in found.steps] == [
        (s.label, _read_again(s.command), s.at_s) for s in expected.steps
    ]
    for mine, theirs in zip(_measures(found), _measures(expected), strict=True):
        assert_same_measures(mine, theirs)
    documents = list(zip(found.history().documents(), expected.history().documents(), strict=True))
    for one, other in documents if deep else [documents[found.position]]:
        assert_same_document(one, other, case)
