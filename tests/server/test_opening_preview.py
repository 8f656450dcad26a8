"""Tests of the preview of a CT that is being opened, as the windows receive it."""

from __future__ import annotations

import base64
import contextlib
import threading

import pytest
from dicom_writer import chest, series
from live_server import WAIT_S, running

from carina.commands import OpeningPreviewOf
from carina.display.png import png_pixels
from carina.errors import VolumeImportError
from carina.server.files.uploads import Limits
from carina.server.wire import messages as wire
from carina.session import default_parts


class HeldOpening:
    """Function that opens a CT and waits within the reading of the slices until the test releases it."""

    def __init__(self):
        self.may_end, self.error = threading.Event(), None

    def __call__(self, path, progress, cancel, **options):
        def held(what, fraction):
            if what == "Reading the slices" and fraction:
                while not self.may_end.is_set() and not cancel():
                    self.may_end.wait(0.01)
                if self.error is not None:
                    raise self.error
            progress(what, fraction)

        return default_parts().open_volume(path, held, cancel, **options)


def dropped(live, folder):
    """Upload the files of a folder as a browser does when they are dropped; return the identifier."""
    live.uploads._limits = Limits()  # the tests of the server have lower ones
    with live.http(cookie=live.cookie, origin=live.origin) as http:
        upload_id = http.post("/api/upload").json()["upload_id"]
        for path in sorted(one for one in folder.rglob("*") if one.is_file()):
            name = path.relative_to(folder).as_posix()
            sent = http.put(f"/api/upload/{upload_id}", params={"name": name}, content=path.read_bytes())
            assert sent.status_code == 201
    return upload_id


@contextlib.contextmanager
def opening(tmp_path, folder, *, is_dropped=False):
    """Open a folder in a window; yield server, window, opening function and the preview, while slices are read."""
    held = HeldOpening()
    with running(tmp_path, open_volume=held) as live, live.window() as window:
        try:
            window.send(wire.OpenUpload(dropped(live, folder)) if is_dropped else wire.OpenPath(str(folder)))
            preview = window.until(has_slice)
            yield live, window, held, preview
        finally:
            held.may_end.set()


def is_preview(message):
    return isinstance(message, wire.OpeningMessage) and message.job_id is not None


def has_slice(message):
    return is_preview(message) and message.slice is not None


def is_removal(message):
    return isinstance(message, wire.OpeningMessage) and message.job_id is None


@pytest.mark.parametrize("end", ["shown", "failed", "cancelled"])
def test_slice_is_sent_while_the_ct_is_read_and_removed_at_every_end(tmp_path, end):
    folder = series(tmp_path / "scan")
    with opening(tmp_path, folder) as (live, window, held, preview):
        found = preview.slice
        assert (found.number, found.num_slices, found.height_lps_mm, found.is_hu) == (11, 20, 25.0, True)
        assert (found.width_mm, found.height_mm) == pytest.approx((32 * 0.7, 32 * 0.9))
        assert png_pixels(base64.b64decode(found.picture)).shape == (32, 32, 3)
        assert not any(isinstance(m, wire.State) and m.case is not None for m in window.seen)
        with live.window() as reloaded:
            assert reloaded.until(is_preview) == preview
        if end == "failed":
            held.error = VolumeImportError("a slice is damaged", code="import.truncated")
        if end == "cancelled":
            window.send(wire.Cancel(preview.job_id))
        else:
            held.may_end.set()
        window.until(is_removal)
        if end == "shown":
            window.until_state(lambda state: state.case is not None)
        else:
            outcome = window.until(lambda m: isinstance(m, wire.Done) and m.job_id == preview.job_id).outcome
            assert outcome == end
        assert live.session.ask(OpeningPreviewOf()) is None
        assert live.session.jobs.wait_idle(WAIT_S)


@pytest.fixture
def mixed(tmp_path):
    """Return a folder with a long and a short series of two patients, and a scout that cannot be opened."""

    def other_patient(dataset, _index):
        dataset.PatientID = dataset.PatientName = "SECRET-2"
        dataset.SeriesDescription = "Soft"

    def scout(dataset, _index):
        dataset.ImageType, dataset.SeriesDescription = ["ORIGINAL", "PRIMARY", "LOCALIZER"], "Topogram"

    series(tmp_path / "scan" / "a", number=3)
    series(tmp_path / "scan" / "b", other_patient, number=4, hu=chest(16, seed=6))
    return series(tmp_path / "scan" / "c", scout, number=1, hu=chest()[:1]).parent


def test_series_are_listed_with_pictures_before_the_ct_is_open_without_names_of_patients(tmp_path, mixed):
    with opening(tmp_path, mixed) as (live, window, _held, preview):
        assert [(one.key, one.description, one.num_slices) for one in preview.series] == [
            ("3", "Thorax", 20),
            ("4", "Soft", 16),
            ("1", "Topogram", 1),
        ]
        assert (preview.chosen, preview.num_patients) == ("3", 2)
        assert preview.series[0].likeliest.startswith("the likeliest chest CT: 48 mm in slices 2.5 mm apart")
        assert [one.refused is None for one in preview.series] == [True, True, False]
        window.send(wire.AskSeriesPictures(preview.list_id))
        keys = set()
        while keys != {"1", "3", "4"}:
            picture = window.until(lambda m: isinstance(m, wire.SeriesPictureMessage))
            assert picture.list_id == preview.list_id
            keys.add(picture.key)
        assert live.session.snapshot().case is None
        assert not any("secret" in wire.encode_message(m).lower() for m in window.seen)


@pytest.mark.parametrize("is_dropped", [False, True])
def test_other_series_is_opened_instead_and_the_first_opening_is_cancelled(tmp_path, mixed, is_dropped):
    with opening(tmp_path, mixed, is_dropped=is_dropped) as (live, window, held, preview):
        window.send(wire.OpenSeries("4", preview.job_id))
        chosen = window.until(lambda m: is_preview(m) and m.chosen == "4")
        assert (chosen.list_id, chosen.series) == (preview.list_id, preview.series)
        # Only the newest preview is sent, so the first one of the new job may already contain the slice.
        shown = chosen if has_slice(chosen) else window.until(has_slice)
        assert (shown.job_id, shown.list_id, shown.slice.num_slices) == (chosen.job_id, preview.list_id, 16)
        assert not any(is_removal(m) for m in window.seen), "the list stays on screen"
        window.received(lambda m: isinstance(m, wire.Done) and (m.job_id, m.outcome) == (preview.job_id, "cancelled"))
        held.may_end.set()
        state = window.until_state(lambda state: state.case is not None)
        assert (state.case.series.key, state.case.shape_zyx[0]) == ("4", 16)
        window.send(wire.OpenSeries("3", chosen.job_id))
        assert window.until(lambda m: isinstance(m, wire.Error)).code == "session.opening"
        assert live.session.snapshot().case_number == 1
        if is_dropped:
            # The end of the cancelled job has not deleted the files, from which the first series can be opened.
            window.send(wire.OpenSeries("3", None))
            window.until_state(lambda state: state.case is not None and state.case.series.key == "3")
