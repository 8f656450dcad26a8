"""Tests of reading another process's live file: the content equals the saved one.

Unchanged parts are not read again.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cached_test_data import cached_phantom
from carina import commands as c
from carina.case import CaseFile, CaseFileError, CaseFollower, SourceFacts
from carina.session.attach.select import do_and_wait, program_session
from carina.track import FoldedAirways
from carina.volume import Volume


@pytest.fixture
def live(tmp_path):
    """Return a volume, a session and the case file to which its moments are saved."""
    volume = cached_phantom(spacing_mm=3.0, generations=3).volume
    session = program_session()
    with CaseFile.create(tmp_path / "case.carina", SourceFacts.of(volume, "ab" * 32)) as file:
        yield volume, session, file
    session.close()


def saved(session, file):
    file.save(session.ask(c.CurrentMoment()))


def labels(moment):
    return [step.label for step in moment.steps[: moment.position]]


def test_content_read_by_a_follower_equals_the_saved_content_and_shares_unchanged_parts(live):
    volume, session, file = live
    follower = CaseFollower(file.path, volume)
    with pytest.raises(CaseFileError) as empty:
        follower.latest_moment()
    assert empty.value.code == "case.empty"
    do_and_wait(session, c.OpenVolume(volume))
    saved(session, file)
    first = follower.latest_moment()
    assert follower.latest_moment() is first
    found = first.history().current
    tip = found.airways.tree.tips()[0]

    do_and_wait(session, c.EditTree(c.RenameBranch(tip.id, "here")))
    saved(session, file)
    renamed = follower.latest_moment().history().current
    assert renamed.airways.tree.branch(tip.id).name == "here"
    assert renamed.airways.lumen_zyx is found.airways.lumen_zyx

    do_and_wait(session, c.SetFov(100.0))
    saved(session, file)
    wider = follower.latest_moment()
    assert wider.history().current.look.fov_deg == 100.0
    # The edited airways did not change, so the follower returns the same object.
    assert wider.history().current.airways is renamed.airways

    do_and_wait(session, c.Undo())
    do_and_wait(session, c.Undo())
    saved(session, file)
    back = follower.latest_moment()
    assert labels(back) == []
    assert back.history().current.airways is found.airways
    # Airways of earlier steps are stored compressed.
    assert all(isinstance(step.document.airways, FoldedAirways) for step in back.steps)

    do_and_wait(session, c.Redo())
    saved(session, file)
    again = follower.latest_moment().history().current.airways
    assert again.tree.branch(tip.id).name == "here"
    assert np.array_equal(again.lumen_zyx, renamed.airways.lumen_zyx)


def test_follower_reads_a_file_again_from_the_start_after_its_unused_rows_were_deleted(live):
    volume, session, file = live
    follower = CaseFollower(file.path, volume)
    do_and_wait(session, c.OpenVolume(volume))
    do_and_wait(session, c.SetFov(100.0))
    do_and_wait(session, c.SetFov(110.0))
    saved(session, file)
    assert follower.latest_moment().history().current.look.fov_deg == 110.0
    # Undone and replaced steps leave rows that are no longer used; they are deleted when the file is closed.
    do_and_wait(session, c.Undo())
    do_and_wait(session, c.SetOutline("none"))
    saved(session, file)
    file.close()
    with CaseFile.open(file.path) as again:
        moment = again.load(volume)
        do_and_wait(session, c.SetFov(120.0))
        again.save(replace(session.ask(c.CurrentMoment()), tip=moment.tip))
        latest_moment = follower.latest_moment()
    assert latest_moment.history().current.look.fov_deg == 120.0
    assert labels(latest_moment) == labels(session.ask(c.CurrentMoment()))


def test_follower_refuses_a_file_of_another_scan_or_schema(live):
    volume, session, file = live
    do_and_wait(session, c.OpenVolume(volume))
    saved(session, file)
    other = Volume(volume.hu_zyx[1:], volume.lps_from_ijk)
    with pytest.raises(CaseFileError) as refused:
        CaseFollower(file.path, other).latest_moment()
    assert refused.value.code == "case.other-scan"
