"""Tests of a session that follows another: it shows the owner's state and can take the case over."""

from __future__ import annotations

import time

import pytest

from cached_test_data import cached_phantom
from carina import commands as c
from carina.case import CaseFollower
from carina.errors import UsageError
from carina.session import case_files
from carina.session.attach.select import do_and_wait, program_session
from carina.session.store.registry import CaseRecords
from carina.volume import write_grid


@pytest.fixture
def pair(tmp_path):
    """Return an owner, a session that follows it, and the connection between them."""
    volume = cached_phantom(spacing_mm=3.0, generations=3).volume
    write_grid(tmp_path / "ct.nii.gz", volume.hu_zyx, volume.lps_from_ijk, what="the phantom")
    records = CaseRecords(tmp_path / "cases", time.time)
    owner, other = (program_session(records=records, files=case_files(None, records)) for _ in range(2))
    do_and_wait(owner, c.OpenPath(str(tmp_path / "ct.nii.gz")))
    do_and_wait(owner, c.KeepNow())
    case_id, _ = owner.cases.open_case
    volume = owner.snapshot().case.volume
    follower = CaseFollower(records.path_of(records.find(case_id)), volume)
    do_and_wait(other, c.OpenVolume(volume, follower.latest_moment(), follows=True))

    def follow():
        do_and_wait(owner, c.KeepNow())
        do_and_wait(other, c.FollowMoment(follower.latest_moment()))

    yield owner, other, follow, case_id
    owner.close()
    other.close()


def test_following_session_shows_changes_of_the_owner_and_reuses_its_renderer_content(pair):
    owner, other, follow, _ = pair
    content = other.scene().content_number
    do_and_wait(owner, c.SetOutline("none"))
    do_and_wait(owner, c.GoTo(40.0))
    follow()
    assert other.history() == owner.history()
    assert other.pose_info().path_mm == pytest.approx(40.0)
    assert other.scene().content_number == content, "the lumen is the same and is not sent to the renderer again"
    do_and_wait(owner, c.Undo())
    follow()
    assert other.history() == ()
    assert other.snapshot().redo_label == owner.snapshot().redo_label


def test_view_settings_of_a_following_session_are_independent_of_those_of_the_owner(pair):
    owner, other, follow, _ = pair
    do_and_wait(other, c.SetTexture(on=False))
    do_and_wait(owner, c.SetShading(on=False))
    follow()
    assert (other.snapshot().sight.texture, other.snapshot().sight.shading) == (False, True)


def test_claim_on_a_ct_can_be_obtained_after_a_refused_takeover_of_its_case(pair):
    owner, other, _, case_id = pair
    saver = owner._saving._saver
    # The claim is released, because an owner that took over the case itself may have none.
    saver._claim.release()
    with pytest.raises(UsageError):
        do_and_wait(other, c.TakeOver(case_id))
    claim = owner._saving.records.claim(saver.digest)
    assert claim is not None, "the claim is free, so no window is warned of an open CT"
    claim.release()


def test_following_session_takes_over_a_case_only_after_its_owner_closed_it(pair):
    owner, other, _, case_id = pair
    do_and_wait(owner, c.SetFov(100.0))
    with pytest.raises(UsageError) as held:
        do_and_wait(other, c.TakeOver(case_id))
    assert held.value.code == "case.open"
    do_and_wait(owner, c.CloseCase())
    do_and_wait(other, c.TakeOver(case_id))
    assert other.snapshot().document.look.fov_deg == 100.0
    assert other.cases.open_case[0] == case_id
    do_and_wait(other, c.SetFov(110.0))
    do_and_wait(other, c.KeepNow())
    do_and_wait(other, c.CloseCase())
    do_and_wait(owner, c.OpenRecent(case_id))
    assert owner.snapshot().document.look.fov_deg == 110.0
    with pytest.raises(UsageError, match="no longer in the list"):
        do_and_wait(owner, c.TakeOver("another"))
