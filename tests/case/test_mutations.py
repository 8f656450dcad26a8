"""Tests of case files with one mutation and correct digests: each opens with its content, or is refused as damaged.

After each mutation, the start page opens and lists the case or shows a message.
"""

from __future__ import annotations

import contextlib
import json
import math
import shutil
import sqlite3
import traceback
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from mutated_case import Mutator
from sample_case import ActiveCase, assert_same_moment, load_lazy_parts, save_steps, source_of

from carina.case import CaseFile, Target
from carina.case.bounds import MAX_LABEL_CHARS, MAX_S
from carina.case.document import Lesion
from carina.case.routes import path_move
from carina.commands import AddTarget
from carina.errors import CarinaError
from carina.navigate import Navigator, Pilot
from carina.plan import PlanTarget
from carina.plan.targets.edits import sphere
from carina.scopes import Pose
from carina.server.to_wire.session import start_message
from carina.server.wire import messages_from_server as wire
from carina.server.wire.messages import encode_message
from carina.session.cases.case_list import CaseList
from carina.session.core import SessionCore
from carina.session.saving.autosave import Autosave
from carina.session.store.registry import CaseRecords
from carina.session.store.registry_repair import repair_records

NUM_MUTATIONS, NUM_IN_SOAK = 60, 2000


@pytest.fixture(scope="module")
def saved_case(tmp_path_factory):
    """Return a case with all kinds of content, and its file."""
    path = tmp_path_factory.mktemp("made") / "one.carina"
    active_case = ActiveCase()
    steps = ("target", "measure", "cut", "measure", "key", "paint", "look", "undo", "redo", "gaze")
    with CaseFile.create(path, source_of(active_case.case)) as file:
        save_steps(file, active_case, steps)
        middle = tuple(float(v) for v in active_case.case.volume.centre_lps)
        nodule = sphere(active_case.case.volume, middle, 8.0)
        lesion = Lesion(PlanTarget("target-2", "nodule", nodule, middle, "sphere", "lung"))
        target = Target("target-2", "nodule", middle, lesion=lesion, note="größer", problem="no path")
        document = replace(active_case.document, targets=(*active_case.document.targets, target))
        active_case.change("mark a ball", document, AddTarget(middle))
        file.save(active_case.moment())
        file.set_extra("plan", ({"words": "größer", "score": [1.5, 2]},))
        header = {"format": "carina-recording", "version": 1, "tip": active_case.moment().tip, "begin": []}
        pose = np.eye(4).ravel().tolist()
        lines = [header, {"t": 0.5, "view": {}}, {"t": 0.75, "move": {"move": "Stop"}, "pose": pose}, {"end": 1.0}]
        with file.record("flight", begun_s=1.0) as recording:
            for line in lines:
                recording.write(json.dumps(line) + "\n")
    return active_case, path


def mutated(saved_case, path, seed):
    """Return a copy with one mutation, and the description of the mutation."""
    shutil.copy(saved_case[1], path)
    with contextlib.closing(sqlite3.connect(path, isolation_level=None)) as connection:
        connection.execute("PRAGMA foreign_keys=OFF")
        mutator = Mutator(connection, seed)
        mutator.mutate()
    return mutator.description


def opened(path, active_case, again):
    """Assert that a case file can be read completely, and that its content is equal after saving and reopening."""
    volume = active_case.case.volume
    with CaseFile.open(path, read_only=True) as file:
        history, recordings = file.history(), file.recordings()
        file.summary()
        for facts in recordings:
            file.recording(facts.recording_id).recorded_poses()
        file.extra("plan")
        moment = file.load(volume)
        source = file.source
    assert all(0.0 <= step.at_s <= MAX_S and len(step.label) <= MAX_LABEL_CHARS for step in history)
    assert all(math.isfinite(one.begun_s + one.length_s) for one in recordings)
    document = moment.history().current
    load_lazy_parts(moment, [document], active_case.case)
    # Set the pose and the path as a session does.
    pilot = Pilot(Navigator(Pose.looking((0.0, 0.0, 0.0), (0.0, 0.0, -1.0)), volume=volume))
    pilot.apply(path_move(None if document.airways is None else document.airways.tree, document.route))
    pilot.navigator.restore(moment.tip, pilot.navigator.path)
    steps = tuple(wire.HistoryStep(step.label, round(step.at_s, 3)) for step in history)
    json.loads(encode_message(wire.HistoryMessage(steps, moment.position)), parse_constant=pytest.fail)
    with CaseFile.create(again, source) as file:
        file.save(moment)
    with CaseFile.open(again) as file:
        found = file.load(volume)
    assert lesions(found) == lesions(moment)
    assert_same_moment(without_lesions(found), without_lesions(moment), active_case.case, deep=False)


def lesions(moment):
    """Return the boundaries of the targets of a case's shown document, as values that can be compared."""
    return [one.lesion and one.lesion.target.to_record() for one in moment.history().current.targets]


def without_lesions(moment):
    def plain(document):
        return replace(document, targets=tuple(replace(one, lesion=None) for one in document.targets))

    steps = tuple(replace(step, document=plain(step.document)) for step in moment.steps)
    return replace(moment, first=plain(moment.first), steps=steps)


def start_page(path, folder):
    """Return the contents of the start page for a data folder with this case and an unreadable record."""
    place = folder / "cases" / "0123456789abcdef"
    place.mkdir(parents=True)
    shutil.copy(path, place / "case.carina")
    (place / "record.json").write_text('{"format": "carina-record", "version": 1, "begun_s": -Infinity}')
    records = CaseRecords(folder / "cases", lambda: 1.7e9)
    messages = repair_records(records)
    assert len(messages) == 1
    core = SessionCore(lambda *_: None)
    listed = CaseList(core, Autosave(core, records, None)).listed()
    assert len(listed) == len(records.all())
    # The case is listed, or its folder is in ``.damaged``.
    assert len(listed) + len(list((folder / "cases" / ".damaged").glob("*/case.carina"))) == 1
    text = encode_message(start_message(notice_accepted=True, recent=listed, patient_citation=None, storage=None))
    json.loads(text, parse_constant=pytest.fail)
    return len(listed)


def where(trouble):
    """Return the last lines of the traceback, for a failing test."""
    frames = traceback.extract_tb(trouble.__traceback__)[-3:]
    return "; ".join(f"{frame.filename.rpartition('/')[2]}:{frame.lineno}" for frame in frames)


def run(saved_case, folder, seeds):
    """Return the numbers of cases that open, are refused (by code) and are listed, and a list of all other errors."""
    found, wrong = Counter(), []
    for seed in seeds:
        place = folder / str(seed)
        place.mkdir()
        path = place / "mutated.carina"
        change = mutated(saved_case, path, seed)
        before = path.read_bytes()
        try:
            opened(path, saved_case[0], place / "again.carina")
            found["opened"] += 1
        except CarinaError as refusal:
            found[refusal.code] += 1
            if len(str(refusal)) > 1000:
                wrong.append(f"seed {seed}: {change}: a message of {len(str(refusal))} characters")
        except Exception as error:
            wrong.append(f"seed {seed}: {change}: {type(error).__name__}: {str(error)[:300]} at {where(error)}")
        try:
            found["listed"] += start_page(path, place)
        except Exception as error:
            wrong.append(
                f"seed {seed}, start page: {change}: {type(error).__name__}: {str(error)[:300]} at {where(error)}"
            )
        assert path.read_bytes() == before
        shutil.rmtree(place)
    return found, wrong


def test_case_without_random_damage_opens_and_is_listed(saved_case, tmp_path):
    opened(saved_case[1], saved_case[0], tmp_path / "again.carina")
    assert start_page(saved_case[1], tmp_path) == 1


def test_randomly_damaged_case_opens_or_is_refused_and_the_start_page_opens(saved_case, tmp_path):
    found, wrong = run(saved_case, tmp_path, range(NUM_MUTATIONS))
    assert wrong == [], "\n".join(wrong)
    # Some mutations must be harmless and some must be fatal.
    assert found["opened"] >= 5
    assert found["case.damaged"] >= 20


@pytest.mark.soak
def test_2000_randomly_damaged_cases_open_or_are_refused_and_the_start_page_opens(saved_case, tmp_path):
    found, wrong = run(saved_case, tmp_path, range(1000, 1000 + NUM_IN_SOAK))
    print(dict(found))
    assert wrong == [], "\n".join(wrong)
