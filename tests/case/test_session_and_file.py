"""A session over a real case file: real edits, folded steps, a crash, and undo as if nothing had happened."""

from __future__ import annotations

import numpy as np
import pytest
from edit_case import edit_case
from kept_case import assert_same_document

from carina.case import KeptAirways
from carina.commands import AddTarget, EditTree, OpenPath, SetFov
from carina.render import transfer_preset
from carina.session import Session, Trouble
from carina.session.case_files import case_files
from carina.session.editing import NUM_EDITS_WHOLE
from carina.session.records import CaseRecords
from carina.track import PaintLumen, RenameBranch, edit_airways
from small_case import Background, Clock, SmallRenderer, small_parts


def started(folder):
    case = edit_case()
    background = Background()
    session = Session(
        SmallRenderer,
        parts=small_parts(
            open_volume=lambda _path, _progress, _cancel: case.volume,
            find_airways=lambda _volume, **_options: case.airways,
            edit_airways=edit_airways,
            transfer_preset=transfer_preset,
        ),
        submit=background,
        clock=Clock(),
        records=CaseRecords(folder / "cases", lambda: 1_800_000_000.0),
        files=case_files(),
    )
    events = []
    session.subscribe(events.append)
    session.do(OpenPath("case"))
    background.run_all()
    assert [e.message for e in events if isinstance(e, Trouble)] == []
    return session, background


def worked(session, background):
    """More steps than are kept whole."""
    case = edit_case()
    for n in range(NUM_EDITS_WHOLE + 4):
        tip = case.tips[n % 4] + 0.4 * n * np.array([0.3, 0.1, 1.0])
        edit = PaintLumen((tuple(float(v) for v in tip),), 1.5, "ball", erase=n % 3 == 2)
        session.do(EditTree(edit if n % 4 else RenameBranch(3, f"mine {n}")))
        background.run_all()
    session.do(AddTarget(tuple(float(v) for v in case.tips[1])))
    background.run_all()
    session.do(SetFov(100.0))


def document(session):
    return session.snapshot().document


@pytest.mark.parametrize("is_killed", [False, True])
def test_undo_after_reopening_comes_to_every_step_as_it_does_without(tmp_path, is_killed):
    session, background = started(tmp_path)
    worked(session, background)
    assert session._saving.write_now()
    if is_killed:
        # Nothing more is written; the system gives the lock back, and the journal stays.
        kept = session._saving._kept
        kept.held.release()
        session._saving._kept = None
        kept.file._connection = None
    else:
        # It stays open to be compared with; its file goes.
        kept = session._saving._kept
        session._saving._kept = None
        kept.file.close()
        kept.held.release()
    again, other_background = started(tmp_path)
    assert again.history() == session.history()
    assert any(isinstance(d.airways, KeptAirways) for d in again._core.case.history.documents())
    for one in (session, again):
        one.do(EditTree(RenameBranch(2, "after")))
    background.run_all()
    other_background.run_all()
    while session.snapshot().undo_label is not None:
        assert_same_document(document(again), document(session), edit_case())
        assert again.snapshot().undo_label == session.snapshot().undo_label
        for one, others in ((session, background), (again, other_background)):
            one.undo()
            others.run_all()
    assert again.snapshot().undo_label is None
    for _ in range(3):
        session.redo()
        again.redo()
    assert_same_document(document(again), document(session), edit_case())
    assert again._saving.write_now()
    again.close()
