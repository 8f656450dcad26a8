"""Tests of airway masks from other tools: import, questions to the user, refusals, and undo in one step."""

from __future__ import annotations

import numpy as np
import pytest

from carina.commands import AnswerMask, Cancel, CloseCase, DismissMask, MaskFileNeeded, OpenPath, SetRoot, TakeMask
from carina.errors import NoResultError, UsageError, VolumeImportError
from carina.session import ErrorEvent, JobEnded
from carina.volume import Mask, MaskGridError, MaskLabel, MaskLabelError
from small_case import session_fixture, small_airways, small_lumen

LABELS = (MaskLabel(1, "Left lung", 2100.0), MaskLabel(4, "Airway tree", 61.5), MaskLabel(9, None, 0.2))


class Tool:
    """Replacement of the mask reader and of the airway search; it records the requests."""

    def __init__(self):
        self.read, self.searches = [], []
        self.root_in_mask = True

    def open_mask(self, path, volume, *, label, resample, progress, cancel):
        self.read.append((path, label, resample))
        progress("reading", 0.5)
        if path.endswith("bad.nrrd"):
            raise VolumeImportError("reading the segmentation bad.nrrd: it is empty", code="import.mask")
        if "several" in path and label is None:
            raise MaskLabelError("it contains the labels 1, 4, 9", LABELS)
        if "other" in path and not resample:
            raise MaskGridError("another grid", expected="10 voxels", found="12 voxels", share_inside=0.75)
        return Mask(small_lumen() * np.uint8(1), ("covers a part",))

    def find_airways(self, volume, *, root_lps, lumen_threshold, progress, cancel, **mask):
        self.searches.append((root_lps, mask))
        if mask and root_lps is None and not self.root_in_mask:
            raise NoResultError("no trachea in the mask")
        found = small_airways(volume, root_lps=root_lps)
        if mask:
            found.lumen_zyx, found.report = mask["lumen_zyx"], [*mask["notes"], *found.report]
        return found


@pytest.fixture
def tool():
    return Tool()


@pytest.fixture
def fixture(tool):
    made = session_fixture(open_mask=tool.open_mask, find_airways=tool.find_airways)
    made.open()
    return made


def take(fixture, path, **options):
    fixture.session.do(TakeMask(path, **options))
    fixture.background.run_all()
    return fixture.session.snapshot()


def test_imported_mask_replaces_the_airways_in_one_undo_step(fixture, tool):
    before = fixture.session.snapshot()
    after = take(fixture, "/masks/airway.nii.gz")
    assert after.document.airways is not before.document.airways
    assert (after.airways, after.undo_label) == ("found", "use the segmentation for the airways")
    assert after.airways_words == ("the airway lumen is an imported segmentation; covers a part; three branches")
    assert fixture.renderers[-1].lumen is after.document.airways.lumen_zyx
    assert after.document.lumen_threshold == before.document.lumen_threshold
    fixture.session.undo()
    undone = fixture.session.snapshot()
    assert undone.document.airways is before.document.airways
    assert (undone.airways_words, undone.redo_label) == ("three branches", "use the segmentation for the airways")
    fixture.session.redo()
    assert fixture.session.snapshot().airways_words == after.airways_words
    assert [mask != {} for _, mask in tool.searches] == [False, True]


def test_mask_with_several_structures_requests_a_choice_and_proposes_the_airways(fixture, tool):
    before = fixture.session.snapshot()
    requested = take(fixture, "/masks/several.nrrd")
    question = requested.mask_question
    assert (question.title, question.problem, question.suggested) == ("several.nrrd", "label", 4)
    assert question.labels == LABELS
    assert requested.document is before.document
    assert requested.airways == "found"
    assert fixture.of_type(ErrorEvent) == []
    assert fixture.session.ask(MaskFileNeeded())
    fixture.session.do(AnswerMask(label=4))
    fixture.background.run_all()
    assert fixture.session.snapshot().mask_question is None
    assert fixture.session.snapshot().undo_label == "use the segmentation for the airways"
    assert tool.read[-1] == ("/masks/several.nrrd", 4, False)
    assert not fixture.session.ask(MaskFileNeeded())


@pytest.mark.parametrize(
    ("names", "suggested"),
    [(("Lunge", "Luftröhre"), 2), (("Lung", "Heart"), None), (("Airway", "airway wall"), None), ((None, None), None)],
)
def test_structure_is_proposed_only_if_its_name_identifies_the_airways(fixture, tool, names, suggested):
    labels = tuple(MaskLabel(number, name, 1.0) for number, name in enumerate(names, start=1))

    def open_mask(path, volume, **_):
        raise MaskLabelError("it contains the labels 1, 2", labels)

    tool.open_mask = open_mask
    made = session_fixture(open_mask=open_mask, find_airways=tool.find_airways)
    made.open()
    assert take(made, "/masks/several.nrrd").mask_question.suggested == suggested


def test_mask_on_another_grid_is_reported_and_the_selected_label_is_used_when_resampled(fixture, tool):
    take(fixture, "/masks/several-other.nrrd")
    fixture.session.do(AnswerMask(label=4))
    fixture.background.run_all()
    question = fixture.session.snapshot().mask_question
    assert (question.problem, question.expected, question.found) == ("grid", "10 voxels", "12 voxels")
    assert question.share_inside == 0.75
    fixture.session.do(AnswerMask(resample=True))
    fixture.background.run_all()
    assert tool.read[-1] == ("/masks/several-other.nrrd", 4, True)
    assert fixture.session.snapshot().undo_label == "use the segmentation for the airways"


def test_mask_rejected_by_the_user_leaves_the_airways_unchanged(fixture):
    before = fixture.session.snapshot()
    take(fixture, "/masks/other.nrrd")
    fixture.session.do(DismissMask())
    after = fixture.session.snapshot()
    assert after.mask_question is None
    assert after.document is before.document
    assert after.undo_label is None
    assert not fixture.session.ask(MaskFileNeeded())
    with pytest.raises(UsageError, match="the imported segmentation is no longer available"):
        fixture.session.do(AnswerMask(label=1))


def test_mask_rejected_by_the_user_during_reading_is_not_imported(fixture, tool):
    before = fixture.session.snapshot()
    job_id = fixture.session.do(TakeMask("/masks/airway.nii.gz"))
    assert fixture.session.ask(MaskFileNeeded())
    fixture.session.do(DismissMask())
    fixture.background.run_all()
    assert [e.outcome for e in fixture.of_type(JobEnded) if e.job_id == job_id] == ["cancelled"]
    assert fixture.session.snapshot().document is before.document
    assert not fixture.session.ask(MaskFileNeeded())


def test_file_that_is_not_a_mask_is_refused_with_a_message_and_changes_nothing(fixture):
    before = fixture.session.snapshot()
    after = take(fixture, "/masks/bad.nrrd")
    assert [e.message for e in fixture.of_type(ErrorEvent)] == ["reading the segmentation bad.nrrd: it is empty"]
    assert after.document is before.document
    assert (after.airways, after.airways_words) == (before.airways, before.airways_words)


def test_import_of_a_mask_without_a_trachea_starts_at_the_known_root(fixture, tool):
    tool.root_in_mask = False
    root = tuple(fixture.session.snapshot().document.airways.root_lps)
    assert take(fixture, "/masks/airway.nii.gz").undo_label == "use the segmentation for the airways"
    assert [search[0] for search in tool.searches] == [None, None, root]


def test_mask_is_imported_into_a_case_without_airways_and_undo_restores_none():
    tool = Tool()

    def find_airways(volume, *, root_lps, lumen_threshold, progress, cancel, **mask):
        if not mask:
            raise NoResultError("no trachea found")
        return tool.find_airways(volume, root_lps=root_lps, lumen_threshold=None, progress=None, cancel=None, **mask)

    fixture = session_fixture(open_mask=tool.open_mask, find_airways=find_airways)
    fixture.open()
    assert fixture.session.snapshot().airways == "failed"
    assert take(fixture, "/masks/airway.nii.gz").airways == "found"
    fixture.session.undo()
    undone = fixture.session.snapshot()
    assert (undone.airways, undone.document.airways) == ("failed", None)
    assert "Mark the trachea" in undone.airways_words
    fixture.session.redo()
    assert fixture.session.snapshot().airways == "found"


def test_mask_without_a_trachea_and_without_a_known_root_is_refused(tool):
    def find_airways(volume, *, root_lps, lumen_threshold, progress, cancel, **mask):
        raise NoResultError("no trachea in the mask" if mask else "no trachea found")

    fixture = session_fixture(open_mask=tool.open_mask, find_airways=find_airways)
    fixture.open()
    after = take(fixture, "/masks/airway.nii.gz")
    assert after.airways == "failed"
    assert after.airways_words.startswith("no trachea in the mask. ")


def test_airway_search_replaced_by_a_newer_search_reports_no_result(tool):
    roots = []

    def find_airways(volume, *, root_lps, **options):
        roots.append(root_lps)
        if len(roots) == 1:
            raise NoResultError("no trachea found")
        return small_airways(volume, root_lps=root_lps)

    fixture = session_fixture(open_mask=tool.open_mask, find_airways=find_airways)
    fixture.open()
    root = tuple(float(v) for v in small_airways(fixture.session.snapshot().case.volume).root_lps)
    fixture.session.do(SetRoot(root))
    fixture.session.do(SetRoot(root))
    fixture.background.run_next()
    assert fixture.session.snapshot().airways == "finding"
    fixture.background.run_all()
    assert fixture.session.snapshot().airways == "found"


def test_reading_a_mask_can_be_stopped_without_stopping_the_airway_search(tool):
    fixture = session_fixture(open_mask=tool.open_mask, find_airways=tool.find_airways)
    fixture.session.do(OpenPath("case"))
    fixture.background.run_next()
    job_id = fixture.session.do(TakeMask("/masks/airway.nii.gz"))
    fixture.session.do(Cancel(job_id))
    fixture.background.run_all()
    assert [e.outcome for e in fixture.of_type(JobEnded) if e.job_id == job_id] == ["cancelled"]
    assert fixture.session.snapshot().airways == "found"
    assert fixture.session.snapshot().undo_label is None


def test_mask_import_requires_an_open_case_and_closing_the_case_removes_its_question(fixture):
    take(fixture, "/masks/other.nrrd")
    fixture.session.do(CloseCase())
    assert not fixture.session.ask(MaskFileNeeded())
    with pytest.raises(UsageError, match="no case is open"):
        fixture.session.do(TakeMask("/masks/airway.nii.gz"))
