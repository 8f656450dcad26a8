"""Tests of the renderer's preparation after changes of the transfer function: one job, for the newest."""

from __future__ import annotations

import dataclasses
import threading

import numpy as np
import pytest

from carina import _core, render
from carina.commands import Cancel, OpenVolume, SetTransfer
from carina.errors import TrackingError
from carina.server.frames.pump import FramePump
from carina.session import JobEnded, Session
from carina.session.engines import default_parts
from small_case import session_fixture, small_airways, small_volume


def names(fixture):
    return [job.title for job in fixture.session.jobs.running]


def test_many_display_changes_at_once_start_one_job_that_prepares_the_newest():
    fixture = session_fixture()
    fixture.open()
    renderer = fixture.renderers[-1]
    before = renderer.prepared
    for n in range(20):
        fixture.session.do(SetTransfer(document={"n": n}))
    newest = fixture.session.snapshot().document.transfer
    assert len(fixture.background.waiting) == 1
    fixture.background.run_all()
    assert renderer.transfer is newest
    assert renderer.prepared == before + 1


def test_display_change_during_preparation_restarts_the_preparation_in_the_same_job():
    fixture = session_fixture()
    fixture.open()
    renderer = fixture.renderers[-1]
    fixture.events.clear()
    before = renderer.prepared
    changes = iter(range(3))

    def change():
        if next(changes, None) is not None:
            fixture.session.do(SetTransfer(document={}))

    renderer.on_prepare = change
    fixture.session.do(SetTransfer(preset="ct-grey"))
    fixture.background.run_all()
    assert renderer.transfer is fixture.session.snapshot().document.transfer
    assert renderer.prepared == before + 1, "three builds were stale at the lookup"
    assert [e.outcome for e in fixture.of_type(JobEnded)] == ["done"]
    assert not names(fixture)


def test_display_change_after_the_user_stopped_the_preparation_is_prepared():
    fixture = session_fixture()
    fixture.open()
    renderer = fixture.renderers[-1]
    fixture.session.do(SetTransfer(preset="ct-grey"))
    (job,) = fixture.session.jobs.running
    fixture.session.do(Cancel(job.job_id))
    # The change arrives after the job was stopped, before the job has ended.
    fixture.session.do(SetTransfer(document={}))
    fixture.background.run_all()
    assert renderer.transfer is fixture.session.snapshot().document.transfer
    fixture.session.do(SetTransfer(preset="endoscopic"))
    fixture.background.run_all()
    assert renderer.transfer is fixture.session.snapshot().document.transfer


def test_display_change_after_a_failed_preparation_is_prepared():
    fixture = session_fixture()
    fixture.open()
    renderer = fixture.renderers[-1]

    def fail():
        raise MemoryError

    renderer.on_prepare = fail
    fixture.session.do(SetTransfer(preset="ct-grey"))
    fixture.background.run_all()
    renderer.on_prepare = lambda: None
    fixture.session.do(SetTransfer(preset="endoscopic"))
    fixture.background.run_all()
    assert renderer.transfer is fixture.session.snapshot().document.transfer


@pytest.mark.parametrize("lumen", [False, True])
def test_pictures_with_a_new_preset_are_shown_while_its_isoregion_map_is_built(monkeypatch, lumen):
    """Use the real renderer and the real pump; the test controls when the map is complete."""
    building, go_on = threading.Event(), threading.Event()
    build = _core.build_cell_map

    def slowly(*arguments, **options):
        if options:  # The small map of the tree view has no options and cannot be cancelled.
            building.set()
            assert go_on.wait(60)
        return build(*arguments, **options)

    parts = default_parts()
    volume = small_volume()
    found = small_airways(volume) if lumen else None

    def find_airways(_volume, **_options):
        if found is None:
            raise TrackingError("none in this test")
        return found

    session = Session(
        lambda volume, transfer: render.Renderer(volume, transfer=transfer),
        parts=dataclasses.replace(parts, find_airways=find_airways),
    )
    delivered: list[bytes] = []
    pump = FramePump(session.scene, delivered.append, lambda _message: None, clock=lambda: 0.0)
    try:
        session.do(OpenVolume(volume))
        assert session.jobs.wait_idle(60)
        monkeypatch.setattr(_core, "build_cell_map", slowly)
        everything = render.TransferFunction(points=np.array([[-2000.0, 1, 1, 1, 0.2], [-400.0, 1, 1, 1, 0.9]]))
        session.do(SetTransfer(document=everything.to_json()))
        assert building.wait(60)
        pump.set_layout({"airway": (64, 48), "axial": (32, 32)})
        while pump.step():
            pass
        assert b'"view":"airway"' in delivered[0].replace(b" ", b"")
        assert b'"method":"brute"' in delivered[0].replace(b" ", b"")
        assert len(delivered) >= 2
    finally:
        go_on.set()
        session.close()
