"""Tests of airway masks from other tools: import, questions to the user, refusals, and undo in one step."""

from __future__ import annotations

import numpy as np
import pytest

from carina.commands import AnswerMask, Cancel, CloseCase, DismissMask, MaskFileNeeded, OpenPath, SetRoot, TakeMask
from carina.errors import NoResultError, UsageError, VolumeImportError
from carina.session import ErrorEvent, JobEnded
from carina.volume import Mask, MaskGridError, MaskLabel, MaskLabelError
from small_case import small_airways, small_bench, small_lumen

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
def bench(tool):
    made = small_bench(open_mask=tool.open_mask, find_airways=tool.find_airways)
    made.open()
    return made


def take(bench, path, **options):
    bench.session.do(TakeMask(path, **options))
    bench.background.run_all()
    return bench.session.snapshot()


def test_imported_mask_replaces_the_airways_in_one_undo_step(bench, tool):
    before = bench.session.snapshot()
    after = take(bench, "/masks/airway.nii.gz")
    assert after.document.airways is not before.document.airways
    assert (after.airways, after.undo_label) == ("found", "use the segmentation for the airways")
    assert after.airways_words == ("the airway lumen is an imported segmentation; covers a part; three branches")
    assert bench.renderers[-1].lumen is after.document.airways.lumen_zyx
    assert after.document.lumen_threshold == before.document.lumen_threshold
    bench.session.undo()
    undone = bench.session.snapshot()
    assert undone.document.airways is before.document.airways
    assert (undone.airways_words, undone.redo_label) == ("three branches", "use the segmentation for the airways")
    bench.session.redo()
    assert bench.session.snapshot().airways_words == after.airways_words
    assert [mask != {} for _, mask in tool.searches] == [False, True]


def test_mask_with_several_structures_requests_a_choice_and_proposes_the_airways(bench, tool):
    before = bench.session.snapshot()
    requested = take(bench, "/masks/several.nrrd")
    question = requested.mask_question
    assert (question.title, question.problem, question.suggested) == ("several.nrrd", "label", 4)
    assert question.labels == LABELS
    assert requested.document is before.document
    assert requested.airways == "found"
    assert bench.of_type(ErrorEvent) == []
    assert bench.session.ask(MaskFileNeeded())
    bench.session.do(AnswerMask(label=4))
    bench.background.run_all()
    assert bench.session.snapshot().mask_question is None
    assert bench.session.snapshot().undo_label == "use the segmentation for the airways"
    assert tool.read[-1] == ("/masks/several.nrrd", 4, False)
    assert not bench.session.ask(MaskFileNeeded())


@pytest.mark.parametrize(
    ("names", "suggested"),
    [(("Lunge", "Luftröhre"), 2), (("Lung", "Heart"), None), (("Airway", "airway wall"), None), ((None, None), None)],
)
def test_structure_is_proposed_only_if_its_name_identifies_the_airways(bench, tool, names, suggested):
    labels = tuple(MaskLabel(number, name, 1.0) for number, name in enumerate(names, start=1))

    def open_mask(path, volume, **_):
        raise MaskLabelError("it contains the labels 1, 2", labels)

    tool.open_mask = open_mask
    made = small_bench(open_mask=open_mask, find_airways=tool.find_airways)
    made.open()
    assert take(made, "/masks/several.nrrd").mask_question.suggested == suggested


def test_mask_on_another_grid_is_reported_and_the_selected_label_is_used_when_resampled(bench, tool):
    take(bench, "/masks/several-other.nrrd")
    bench.session.do(AnswerMask(label=4))
    bench.background.run_all()
    question = bench.session.snapshot().mask_question
    assert (question.problem, question.expected, question.found) == ("grid", "10 voxels", "12 voxels")
    assert question.share_inside == 0.75
    bench.session.do(AnswerMask(resample=True))
    bench.background.run_all()
    assert tool.read[-1] == ("/masks/several-other.nrrd", 4, True)
    assert bench.session.snapshot().undo_label == "use the segmentation for the airways"


def test_mask_rejected_by_the_user_leaves_the_airways_unchanged(bench):
    before = bench.session.snapshot()
    take(bench, "/masks/other.nrrd")
    bench.session.do(DismissMask())
    after = bench.session.snapshot()
    assert after.mask_question is None
    assert after.document is before.document
    assert after.undo_label is None
    assert not bench.session.ask(MaskFileNeeded())
    with pytest.raises(UsageError, match="the imported segmentation is no longer available"):
        bench.session.do(AnswerMask(label=1))


def test_mask_rejected_by_the_user_during_reading_is_not_imported(bench, tool):
    before = bench.session.snapshot()
    job_id = bench.session.do(TakeMask("/masks/airway.nii.gz"))
    assert bench.session.ask(MaskFileNeeded())
    bench.session.do(DismissMask())
    bench.background.run_all()
    assert [e.outcome for e in bench.of_type(JobEnded) if e.job_id == job_id] == ["cancelled"]
    assert bench.session.snapshot().document is before.document
    assert not bench.session.ask(MaskFileNeeded())


def test_file_that_is_no_mask_is_refused_with_a_message_and_changes_nothing(bench):
    before = bench.session.snapshot()
    after = take(bench, "/masks/bad.nrrd")
    assert [e.message for e in bench.of_type(ErrorEvent)] == ["reading the segmentation bad.nrrd: it is empty"]
    assert after.document is before.document
    assert (after.airways, after.airways_words) == (before.airways, before.airways_words)


def test_import_of_a_mask_without_a_trachea_starts_at_the_known_root(bench, tool):
    tool.root_in_mask = False
    root = tuple(bench.session.snapshot().document.airways.root_lps)
    assert take(bench, "/masks/airway.nii.gz").undo_label == "use the segmentation for the airways"
    assert [search[0] for search in tool.searches] == [None, None, root]


def test_mask_is_imported_into_a_case_without_airways_and_undo_restores_none():
    tool = Tool()

    def find_airways(volume, *, root_lps, lumen_threshold, progress, cancel, **mask):
        if not mask:
            raise NoResultError("no trachea found")
        return tool.find_airways(volume, root_lps=root_lps, lumen_threshold=None, progress=None, cancel=None, **mask)

    bench = small_bench(open_mask=tool.open_mask, find_airways=find_airways)
    bench.open()
    assert bench.session.snapshot().airways == "failed"
    assert take(bench, "/masks/airway.nii.gz").airways == "found"
    bench.session.undo()
    undone = bench.session.snapshot()
    assert (undone.airways, undone.document.airways) == ("failed", None)
    assert "Mark the trachea" in undone.airways_words
    bench.session.redo()
    assert bench.session.snapshot().airways == "found"


def test_mask_without_a_trachea_and_without_a_known_root_is_refused(tool):
    def find_airways(volume, *, root_lps, lumen_threshold, progress, cancel, **mask):
        raise NoResultError("no trachea in the mask" if mask else "no trachea found")

    bench = small_bench(open_mask=tool.open_mask, find_airways=find_airways)
    bench.open()
    after = take(bench, "/masks/airway.nii.gz")
    assert after.airways == "failed"
    assert after.airways_words.startswith("no trachea in the mask. ")


def test_airway_search_replaced_by_a_newer_search_reports_no_result(tool):
    roots = []

    def find_airways(volume, *, root_lps, **options):
        roots.append(root_lps)
        if len(roots) == 1:
            raise NoResultError("no trachea found")
        return small_airways(volume, root_lps=root_lps)

    bench = small_bench(open_mask=tool.open_mask, find_airways=find_airways)
    bench.open()
    root = tuple(float(v) for v in small_airways(bench.session.snapshot().case.volume).root_lps)
    bench.session.do(SetRoot(root))
    bench.session.do(SetRoot(root))
    bench.background.run_next()
    assert bench.session.snapshot().airways == "finding"
    bench.background.run_all()
    assert bench.session.snapshot().airways == "found"


def test_reading_a_mask_can_be_stopped_without_stopping_the_airway_search(tool):
    bench = small_bench(open_mask=tool.open_mask, find_airways=tool.find_airways)
    bench.session.do(OpenPath("case"))
    bench.background.run_next()
    job_id = bench.session.do(TakeMask("/masks/airway.nii.gz"))
    bench.session.do(Cancel(job_id))
    bench.background.run_all()
    assert [e.outcome for e in bench.of_type(JobEnded) if e.job_id == job_id] == ["cancelled"]
    assert bench.session.snapshot().airways == "found"
    assert bench.session.snapshot().undo_label is None


def test_mask_import_requires_an_open_case_and_closing_the_case_removes_its_question(bench):
    take(bench, "/masks/other.nrrd")
    bench.session.do(CloseCase())
    assert not bench.session.ask(MaskFileNeeded())
    with pytest.raises(UsageError, match="no case is open"):
        bench.session.do(TakeMask("/masks/airway.nii.gz"))
