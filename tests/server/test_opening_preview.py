"""Tests of the preview of a CT that is being opened, as the windows receive it."""

from __future__ import annotations

import base64
import contextlib
import threading

import pytest
from dicom_writer import series
from live_server import WAIT_S, running

from carina.commands import OpeningPreviewOf
from carina.display.png import png_pixels
from carina.errors import VolumeImportError
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


@contextlib.contextmanager
def opening(tmp_path, folder):
    """Open a folder in a window; yield server, window, opening function and the preview, while slices are read."""
    held = HeldOpening()
    with running(tmp_path, open_volume=held) as live, live.window() as window:
        try:
            window.send(wire.OpenPath(str(folder)))
            preview = window.until(is_preview)
            yield live, window, held, preview
        finally:
            held.may_end.set()


def is_preview(message):
    return isinstance(message, wire.OpeningMessage) and message.job_id is not None


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
