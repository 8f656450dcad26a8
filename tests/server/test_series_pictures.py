"""Tests of the job that sends a picture of each series of the open CT's folder or archive."""

from __future__ import annotations

import base64
import shutil
from types import SimpleNamespace

import pytest
from dicom_writer import series

from carina.commands import SeriesFiles
from carina.errors import CancelledError
from carina.server.series_pictures import start_series_pictures, stop_series_pictures
from carina.server.wire import messages as wire


class SmallSession:
    """Session with the folder of a CT, whose jobs run at once."""

    def __init__(self, path, *, cancel=lambda: False):
        self.path, self.stopped = path, []
        self.jobs = SimpleNamespace(start=self._start, cancel_kinds=lambda *kinds: self.stopped.extend(kinds))
        self._cancel = cancel

    def ask(self, question):
        assert isinstance(question, SeriesFiles)
        return self.path

    def _start(self, kind, _title, work):
        self.kind = kind
        work(SimpleNamespace(progress=lambda *_: None, cancel=self._cancel, check=lambda: None))


@pytest.mark.parametrize("packed", [False, True])
def test_each_series_of_a_folder_or_archive_has_a_picture(tmp_path, packed):
    for number in (1, 2):
        series(tmp_path / "scan" / str(number), number=number)
    path = tmp_path / "scan"
    if packed:
        path = tmp_path / "scan.zip"
        shutil.make_archive(str(tmp_path / "scan"), "zip", tmp_path / "scan")
    sent = []
    start_series_pictures(SmallSession(path), 1, sent.append)
    assert all(isinstance(message, wire.SeriesPictureMessage) for message in sent)
    assert [message.key for message in sent] == ["1", "2"]
    assert all(base64.b64decode(message.picture).startswith(b"\x89PNG") for message in sent)
    assert all(len(wire.encode_message(message)) < 60_000 for message in sent)


def test_closed_list_stops_the_job(tmp_path):
    series(tmp_path / "scan")
    session, sent = SmallSession(tmp_path / "scan", cancel=lambda: True), []
    with pytest.raises(CancelledError):
        start_series_pictures(session, 1, sent.append)
    assert sent == []
    stop_series_pictures(session, 2)
    assert session.kind not in session.stopped, "another window closed its list"
    stop_series_pictures(session, 1)
    assert session.kind in session.stopped


def test_no_job_starts_if_the_files_of_the_series_are_not_known():
    session = SmallSession(None)
    start_series_pictures(session, 1, lambda _: None)
    assert not hasattr(session, "kind")
