"""Tests of permanent case files of each schema: they open with all their content in every later version."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from edit_case import edit_case
from sample_case import whole

from carina.case import CaseFile, migrate
from carina.case.measures import branch_facts
from carina.case.schema import SCHEMA
from carina.server.to_wire.tree import branch_detail_message, tree_message
from carina.server.wire.messages import AskBranchDetail
from carina.session.derived.measurement_cache import MeasuredAirways
from carina.track import CutBranch, edit_airways

SAMPLE_FILES = Path(__file__).parent / "sample_files"
NAMES = sorted(path.stem for path in SAMPLE_FILES.glob("*.carina"))


def content_of(path, volume):
    """Return the content of a case file as JSON values that no change of the code may change."""
    with CaseFile.open(path, read_only=True) as file:
        moment = file.load(volume)
        history = file.history()
        measures = MeasuredAirways(moment.measures)
        measured = [_in_numbers(measures.of(document.airways)) for document in moment.history().documents()]
        recordings = [(r.name, r.length_s, r.complete) for r in file.recordings()]
        extra = file.extra("plan")
    documents = moment.history().documents()
    rows = []
    for document in documents:
        airways = whole(document.airways, edit_case())
        route = document.route
        rows.append(
            {
                "branches": [
                    [b.id, b.parent, b.generation, b.name, round(b.length_mm, 9)] for b in airways.tree.branches
                ],
                "lumen_voxels": int(np.count_nonzero(airways.lumen_zyx)),
                "edits": len(airways.edits),
                "route": None if route is None else [route.route_id, round(route.length_mm, 9), len(route.spans)],
                "targets": [[t.target_id, t.name, list(t.lps), t.length_mm, t.problem] for t in document.targets],
                "keys": [[k.key_id, k.pose.lps_from_camera.tolist()] for k in document.key_frames.frames],
                "look": [document.look.fov_deg, document.transfer.name],
            }
        )
    found = {
        "steps": [[s.label, s.command, s.at_s, s.holds] for s in history],
        "position": moment.position,
        "tip": moment.tip,
        "numbers": moment.numbers,
        "documents": rows,
        "recordings": recordings,
        "extra": extra,
        **({"measured": measured} if any(measured) else {}),
    }
    return json.loads(json.dumps(found))


def _in_numbers(stored):
    if stored is None:
        return None
    measures = stored.load()
    return [
        [
            b.branch_id,
            b.found_by,
            _stored_summary(b.summary),
            round(float(np.nansum(b.edge_mm)), 6),
            round(float(np.nansum(b.area_mm2)), 6),
            int(b.is_usable.sum()),
        ]
        for b in measures.branches
    ] + [[fork.to_json() for fork in measures.forks]]


def _stored_summary(summary):
    """Return the figures of a branch as the file stores them, including a stenosis that is not reported."""
    stored = summary.measured_stenosis
    shown = {name: value for name, value in summary.to_json().items() if name != "min_error_mm"}
    return {**shown, "stenosis": None if stored is None else stored.to_json()}


def test_each_schema_version_has_a_sample_case_file():
    assert NAMES == ["schema-1", "schema-2"]


@pytest.mark.parametrize("name", NAMES)
def test_sample_case_file_of_each_schema_opens_with_all_its_content(name, tmp_path):
    path = shutil.copy(SAMPLE_FILES / f"{name}.carina", tmp_path / "kept.carina")
    case = edit_case()
    assert content_of(path, case.volume) == json.loads((SAMPLE_FILES / f"{name}.json").read_text())
    if name != f"schema-{SCHEMA}":
        migrate(path, tmp_path / "now.carina")
        path = tmp_path / "now.carina"
        assert content_of(path, case.volume) == json.loads((SAMPLE_FILES / f"{name}.json").read_text())
    with CaseFile.open(path) as file:
        airways = whole(file.load(case.volume).history().current.airways, case)
    tip = airways.tree.tips()[0]
    assert tip.id not in {b.id for b in edit_airways(case.volume, airways, CutBranch(tip.id)).tree.branches}


def test_stenosis_of_an_older_case_is_neither_shown_nor_exported_if_it_is_within_its_error():
    with CaseFile.open(SAMPLE_FILES / "schema-2.carina", read_only=True) as file:
        moment = file.load(edit_case().volume)
        (first, *_) = moment.history().documents()
        measures = MeasuredAirways(moment.measures).of(first.airways).load()
    airways = whole(first.airways, edit_case())
    stored = {b.branch_id: b.summary.measured_stenosis for b in measures.branches}
    within = {branch for branch, stenosis in stored.items() if not stenosis.exceeds_error}
    assert within == {1, 2, 3, 4, 5, 6}

    sent = tree_message(airways, measures).measures
    assert [one.branch_id for one in sent if one.stenosis_percent is not None] == [0]
    assert [(one.stenosis_error_percent, one.stenosis_at_mm) for one in sent if one.branch_id in within] == [
        (None, None)
    ] * 6
    for row in measures.to_json()["branches"]:
        assert (row["summary"]["stenosis"] is None) == (row["branch"] in within)
    assert {branch.method for branch in measures.branches} == {1}
    assert all(one.by_earlier_method for one in sent)
    for own in measures.branches:
        detail = branch_detail_message(AskBranchDetail(7, own.branch_id), own)
        assert (detail.measures.stenosis_percent is None) == (own.branch_id in within)
        assert (own.summary.stenosis is None) == (own.branch_id in within)
        assert "stenosis" not in repr(own.summary)
        # The values for a second save contain the stenosis as it was measured.
        assert branch_facts(own, None).summary.stenosis is not None
